"""The measurements of ``separation.py``: affected and clean features, and the AUC between them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice

import cv2
import numpy as np
from scipy.stats import rankdata

import probevo as pv
from probevo.arrays import BoolArray, FloatArray, Image, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.predictors import PREDICTORS, Step, prediction_space
from probevo.sequences.frame import Frame
from probevo.tracking import Tracks
from probevo_sim.scene.config import Effects, PresetName, SceneConfig
from probevo_sim.scene.presets.place import SHADOWED_SHARE
from probevo_sim.scene.recording import SceneRecording, open_scene

WARM_UP = 6
"""Frames before those whose features count."""
COUNTED = 24
"""Frames whose features count."""
DISTANCE_M = 60.0
"""Length of a drive, which is longer than both."""
PRESETS: tuple[PresetName, ...] = ("city", "residential")
STRENGTHS = (1.0, 0.5)

PATCH_PX = 21
DIFFERS = 4.0
"""A place is affected where the patch around it differs from the clean picture's by more grey
levels in the mean."""
EVERYWHERE = ("exposure", "noise", "rectification")
"""Effects that affect every feature."""
GRID_PX = 12
CONTRAST_KEPT = 0.5
"""Fixed places are so far apart, and textureless where no more than this share of the standard
deviation is left."""
FAINT_NOISE = 0.15
"""Sensor noise of 2 grey levels, as real cameras have; without it, a textureless road is constant.
"""

SPACE = prediction_space(list(PREDICTORS))
IMAGE_SPACE = prediction_space(["blur", "entropy", "frequency", "structure"])
"""Predictors that are defined at any place of an image, tracked or not."""
OF_A_STEP = ("acceleration", "turn_rate", "velocity")
"""Predictors with one value a step, which cannot separate features of that step."""
FIXED = "textureless, fixed places"
ROWS = (*Effects.model_fields, FIXED)


@dataclass(frozen=True)
class Drive:
    """A drive through a scene, and the N features of its counted frames."""

    scene: SceneRecording
    lefts: dict[int, Image]
    """The left image of each counted frame, by index."""
    frame: IntArray
    """Index of the frame of each feature, [N]."""
    uv: FloatArray
    """Pixels of the features in the left image, [N, 2]."""
    phi: FloatArray
    """Places of the features in the prediction space, [N, M]."""

    def at_features(self, mask: Callable[[int], BoolArray]) -> BoolArray:
        """Return the values at the features, [N], of a mask for each frame, [height, width]."""
        found = np.zeros(len(self.frame), np.bool_)
        for index, left in self.lefts.items():
            here = self.frame == index
            u, v = np.clip(np.round(self.uv[here]).astype(int), 0, np.array(left.shape[::-1]) - 1).T
            found[here] = mask(index)[v, u]
        return found


@dataclass(frozen=True)
class Row:
    """Affected features, [A, M'], against clean ones, [C, M'], by some columns of the space."""

    name: str
    affected: FloatArray
    clean: FloatArray
    columns: tuple[str, ...] = SPACE.columns

    @property
    def aucs(self) -> FloatArray:
        """The AUC of every column of the space, [M]; NaN for one that the row does not have."""
        own = {
            column: auc(self.affected[:, k], self.clean[:, k])
            for k, column in enumerate(self.columns)
        }
        return np.array([own.get(column, np.nan) for column in SPACE.columns])


def auc(affected: FloatArray, clean: FloatArray) -> float:
    """Return P(affected > clean) + P(affected = clean)/2 over all pairs (Mann–Whitney).

    NaN values are left out.
    """
    affected = affected[np.isfinite(affected)]
    clean = clean[np.isfinite(clean)]
    if not len(affected) or not len(clean):
        return float("nan")
    ranks = rankdata(np.concatenate([affected, clean]))[: len(affected)]
    return float((ranks.mean() - 0.5 * (len(affected) + 1)) / len(clean))


def drive(
    config: SceneConfig, *, warm_up: int = WARM_UP, counted: int = COUNTED, calibrate: bool = True
) -> Drive:
    """Drive the first frames of a scene with the shipped defaults."""
    scene = open_scene(config)
    settings = pv.OdometryConfig(estimator="two-frame", self_calibration=calibrate)
    odometry = pv.StereoOdometry(scene.camera, imu=scene.imu, config=settings, predictors=SPACE)
    lefts = {}
    indices = []
    pixels = []
    phis = []
    for frame in islice(scene, warm_up + counted):
        odometry.step(frame)
        if frame.index >= warm_up and frame.left is not None:
            lefts[frame.index] = frame.left
            indices.append(np.full(len(odometry.tracks), frame.index))
            pixels.append(odometry.tracks.curr_px[:, :2])
            phis.append(odometry.phi)
    return Drive(
        scene=scene,
        lefts=lefts,
        frame=np.concatenate(indices),
        uv=np.concatenate(pixels),
        phi=np.concatenate(phis),
    )


def differs(effect: Drive, clean: Drive) -> Callable[[int], BoolArray]:
    """Return a mask of the patches in which an effect's image differs from the clean one.

    The gain of the camera that comes with shadows is no difference.
    """
    gain = 1.0 / (1.0 - SHADOWED_SHARE * effect.scene.config.effects.shadows)

    def mask(index: int) -> BoolArray:
        brightened = np.minimum(gain * clean.lefts[index].astype(np.float64), 255.0)
        difference = np.abs(effect.lefts[index] - brightened)
        return np.asarray(cv2.blur(difference, (PATCH_PX, PATCH_PX)) > DIFFERS)

    return mask


def moves(drive: Drive) -> Callable[[int], BoolArray]:
    """Return a mask of the pixels that show a thing that can move."""
    return lambda index: drive.scene.pixel_truth(index).moving


def rows(name: str, effect: Drive, clean: Drive) -> Iterator[Row]:
    """Yield the effect's row.

    Where it affects only some places, a second row is against clean features of the same places.
    """
    if name.startswith(EVERYWHERE):
        yield Row(name, effect.phi, clean.phi)
        return
    is_traffic = name.startswith("traffic")
    where = moves(effect) if is_traffic else differs(effect, clean)
    affected = effect.at_features(where)
    same_places = clean.at_features(where)
    yield Row(name, effect.phi[affected], effect.phi[~affected] if is_traffic else clean.phi)
    yield Row(f"{name}, same places", effect.phi[affected], clean.phi[same_places])


def fixed_places(name: str, effect: Drive, clean: Drive) -> Row:
    """Return the row of grid points that lost their texture, against the same ones when clean."""
    affected = []
    untouched = []
    for index, left in effect.lefts.items():
        flat = _contrast(left) <= CONTRAST_KEPT * _contrast(clean.lefts[index])
        grid = np.zeros_like(flat)
        grid[GRID_PX // 2 :: GRID_PX, GRID_PX // 2 :: GRID_PX] = True
        uv = np.argwhere(grid & flat & differs(effect, clean)(index))[:, ::-1].astype(np.float64)
        affected.append(at_places(left, uv, effect.scene.camera))
        untouched.append(at_places(clean.lefts[index], uv, clean.scene.camera))
    return Row(name, np.concatenate(affected), np.concatenate(untouched), IMAGE_SPACE.columns)


def at_places(left: Image, uv: FloatArray, camera: StereoCamera) -> FloatArray:
    """Compute the predictors that need only the left image at some of its places, [N, M']."""
    px = np.tile(uv, (1, 2))
    frame = Frame(0, 0, left, right=left)
    tracks = Tracks(px, px, np.arange(len(uv)), age=np.full(len(uv), 2))
    return IMAGE_SPACE(Step(tracks, camera, np.eye(4), prev_frame=frame, curr_frame=frame))


def _contrast(image: Image) -> FloatArray:
    """Return the standard deviation of the patch around each pixel, grey levels."""
    grey = image.astype(np.float64)
    size = (PATCH_PX, PATCH_PX)
    variance = cv2.blur(grey**2, size) - cv2.blur(grey, size) ** 2
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)), np.float64)


def place(number: int) -> list[Row]:
    """Measure all rows of one place; presets alternate, each time with another seed."""
    cv2.setNumThreads(1)
    config = SceneConfig(
        preset=PRESETS[number % len(PRESETS)], seed=number // len(PRESETS), distance_m=DISTANCE_M
    )
    clean = drive(config)
    found: list[Row] = []
    for strength in STRENGTHS:
        for name in Effects.model_fields:
            effect = drive(_with(config, **{name: strength}))
            found += rows(f"{name} {strength:g}", effect, clean)
            if name == "textureless":
                found.append(fixed_places(f"{FIXED} {strength:g}", effect, clean))
    # Rectification errors without the self-calibration that removes a part of them.
    uncalibrated = drive(config, calibrate=False)
    turned = drive(_with(config, rectification=1.0), calibrate=False)
    found += rows("rectification 1, no self-calibration", turned, uncalibrated)
    # A textureless road as a real camera sees it, with noise in both drives.
    noisy = drive(_with(config, noise=FAINT_NOISE))
    flat = drive(_with(config, textureless=1.0, noise=FAINT_NOISE))
    found.append(fixed_places(f"{FIXED} 1, faint noise", flat, noisy))
    print(f"place {number}, {config.preset}, done", file=sys.stderr, flush=True)
    return found


def _with(config: SceneConfig, **effects: float) -> SceneConfig:
    return config.model_copy(update={"effects": Effects(**effects)})
