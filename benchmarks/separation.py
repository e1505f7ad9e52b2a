"""How well each predictor tells features that an effect spoils from clean ones: the figures of docs/predictors.md.

The same drive is rendered without effects and with one. ROC AUC, by ranks, of each column between the features of the
two: 0.5 is chance, +.90 says that of two features the affected one is higher nine times in ten, −.90 that it is lower.

python benchmarks/separation.py [number of places, 4 by default] [folder of the figures]
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
from scipy.stats import rankdata

import probevo as pv
from probevo.arrays import BoolArray, FloatArray, Image, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.predictors import PREDICTORS, Step, prediction_space
from probevo.sequences.frame import Frame
from probevo.simulation.scene.config import Effects, PresetName, SceneConfig
from probevo.simulation.scene.presets.place import SHADOWED_SHARE
from probevo.simulation.scene.recording import SceneRecording, open_scene
from probevo.tracking import Tracks

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "images"
WARM_UP, COUNTED, DISTANCE_M = 6, 24, 60.0
"""Frames before those whose features count, and these; the drive is longer than both."""
PRESETS: tuple[PresetName, ...] = ("city", "residential")
STRENGTHS = (1.0, 0.5)

PATCH_PX, DIFFERS = 21, 4.0
"""A place is affected where the patch around it differs from the clean picture's by more grey levels in the mean."""
EVERYWHERE = ("exposure", "noise", "rectification")
"""Effects that affect every feature."""
GRID_PX, CONTRAST_KEPT = 12, 0.5
"""Fixed places are so far apart, and textureless where no more than this share of the standard deviation is left."""
FAINT_NOISE = 0.15
"""Sensor noise of 2 grey levels, as real cameras have: with it, a textureless road is not flat to the last bit."""

SPACE = prediction_space(list(PREDICTORS))
IMAGE_SPACE = prediction_space(["blur", "entropy", "frequency", "structure"])
"""What can be asked of any place of an image, tracked or not."""
OF_A_STEP = ("acceleration", "turn_rate", "velocity")
"""Predictors that are the same for all features of a step, and so part none of them from the rest."""
FIXED = "textureless, fixed places"
ROWS = (*Effects.model_fields, FIXED)
REQUIRED = (
    ("sharp", "blurred", "blur 1", "blur"),
    ("on what stands", "on what moves", "traffic 1", "residual_flow"),
    ("with texture", "texture taken away", f"{FIXED} 1, faint noise", "high_frequency"),
)
"""What clean and affected features are, row and column: the histograms. Without noise, the third would be a spike."""


@dataclass(frozen=True)
class Drive:
    """A drive through a scene, and the N features of its counted frames."""

    scene: SceneRecording
    lefts: dict[int, Image]
    """The left image of each counted frame, by index."""
    frame: IntArray
    """Index of the frame of each feature, [N]."""
    uv: FloatArray
    """Where it is in the left image, [N, 2], px."""
    phi: FloatArray
    """[N, M]."""

    def at_features(self, mask: Callable[[int], BoolArray]) -> BoolArray:
        """The values of one mask a frame, [height, width], at the features, [N]."""
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
        """Of every column of the space, [M]; NaN where it was not asked."""
        own = {c: auc(self.affected[:, k], self.clean[:, k]) for k, c in enumerate(self.columns)}
        return np.array([own.get(column, np.nan) for column in SPACE.columns])


def auc(affected: FloatArray, clean: FloatArray) -> float:
    """P(affected > clean) + P(affected = clean)/2 over all pairs (Mann–Whitney); NaN values are left out."""
    affected, clean = affected[np.isfinite(affected)], clean[np.isfinite(clean)]
    if not len(affected) or not len(clean):
        return float("nan")
    ranks = rankdata(np.concatenate([affected, clean]))[: len(affected)]
    return float((ranks.mean() - 0.5 * (len(affected) + 1)) / len(clean))


def drive(config: SceneConfig, *, warm_up: int = WARM_UP, counted: int = COUNTED, calibrate: bool = True) -> Drive:
    """Drive the first frames of a scene with the shipped defaults."""
    scene, lefts, parts = open_scene(config), {}, []
    settings = pv.OdometryConfig(self_calibration=calibrate)
    odometry = pv.StereoOdometry(scene.camera, imu=scene.imu, config=settings, predictors=SPACE)
    for frame in islice(scene, warm_up + counted):
        odometry.step(frame)
        if frame.index >= warm_up and frame.left is not None:
            lefts[frame.index] = frame.left
            parts.append((np.full(len(odometry.tracks), frame.index), odometry.tracks.curr_px[:, :2], odometry.phi))
    index, uv, phi = (np.concatenate(values) for values in zip(*parts, strict=True))
    return Drive(scene, lefts, index, uv, phi)


def differs(effect: Drive, clean: Drive) -> Callable[[int], BoolArray]:
    """Where patches of the effect's picture differ from the clean one's, but for the gain that goes with shadows."""
    gain = 1.0 / (1.0 - SHADOWED_SHARE * effect.scene.config.effects.shadows)

    def mask(index: int) -> BoolArray:
        expected = np.minimum(gain * clean.lefts[index].astype(np.float64), 255.0)
        return np.asarray(cv2.blur(np.abs(effect.lefts[index] - expected), (PATCH_PX, PATCH_PX)) > DIFFERS)

    return mask


def moves(drive: Drive) -> Callable[[int], BoolArray]:
    """Which pixels show a thing that can move."""
    return lambda index: drive.scene.pixel_truth(index).moving


def rows(name: str, effect: Drive, clean: Drive) -> Iterator[Row]:
    """The effect's row; where it affects some places only, against the clean features of the same places too."""
    if name.startswith(EVERYWHERE):
        yield Row(name, effect.phi, clean.phi)
        return
    is_traffic = name.startswith("traffic")
    where = moves(effect) if is_traffic else differs(effect, clean)
    affected, same_places = effect.at_features(where), clean.at_features(where)
    yield Row(name, effect.phi[affected], effect.phi[~affected] if is_traffic else clean.phi)
    yield Row(f"{name}, same places", effect.phi[affected], clean.phi[same_places])


def fixed_places(name: str, effect: Drive, clean: Drive) -> Row:
    """Points of a grid on what has lost its texture, against the same points of the clean drive."""
    affected, untouched = [], []
    for index, left in effect.lefts.items():
        flat = _contrast(left) <= CONTRAST_KEPT * _contrast(clean.lefts[index])
        grid = np.zeros_like(flat)
        grid[GRID_PX // 2 :: GRID_PX, GRID_PX // 2 :: GRID_PX] = True
        uv = np.argwhere(grid & flat & differs(effect, clean)(index))[:, ::-1].astype(np.float64)
        affected.append(at_places(left, uv, effect.scene.camera))
        untouched.append(at_places(clean.lefts[index], uv, clean.scene.camera))
    return Row(name, np.concatenate(affected), np.concatenate(untouched), IMAGE_SPACE.columns)


def at_places(left: Image, uv: FloatArray, camera: StereoCamera) -> FloatArray:
    """The predictors that look at nothing but the left image, at any of its places, [N, M']."""
    px, frame = np.tile(uv, (1, 2)), Frame(0, 0, left, left)
    tracks = Tracks(px, px, np.arange(len(uv)), np.full(len(uv), 2))
    return IMAGE_SPACE(Step(tracks, camera, np.eye(4), frame, frame))


def _contrast(image: Image) -> FloatArray:
    """Standard deviation of the patch around each pixel, grey levels."""
    grey, size = image.astype(np.float64), (PATCH_PX, PATCH_PX)
    variance = cv2.blur(grey**2, size) - cv2.blur(grey, size) ** 2
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)), np.float64)


def place(number: int) -> list[Row]:
    """All rows of one place; presets take turns, each with another seed."""
    cv2.setNumThreads(1)
    config = SceneConfig(preset=PRESETS[number % len(PRESETS)], seed=number // len(PRESETS), distance_m=DISTANCE_M)
    clean = drive(config)
    found: list[Row] = []
    for strength in STRENGTHS:
        for name in Effects.model_fields:
            effect = drive(_with(config, **{name: strength}))
            found += rows(f"{name} {strength:g}", effect, clean)
            if name == "textureless":
                found.append(fixed_places(f"{FIXED} {strength:g}", effect, clean))
    turned = drive(_with(config, rectification=1.0), calibrate=False)
    found += rows("rectification 1, no self-calibration", turned, drive(config, calibrate=False))
    faint = drive(_with(config, textureless=1.0, noise=FAINT_NOISE)), drive(_with(config, noise=FAINT_NOISE))
    found.append(fixed_places(f"{FIXED} 1, faint noise", *faint))
    print(f"place {number}, {config.preset}, done", file=sys.stderr, flush=True)
    return found


def _with(config: SceneConfig, **effects: float) -> SceneConfig:
    return config.model_copy(update={"effects": Effects(**effects)})


def signed(value: float) -> str:
    """+.93 is high where affected, −.93 low; empty if not asked."""
    if np.isnan(value):
        return ""
    return ("+" if value >= 0.5 else "−") + f"{max(value, 1.0 - value):.2f}".removeprefix("0")


def print_table(title: str, cells: dict[str, list[str]]) -> None:
    """A line for each column of the space that has any cell, in Markdown."""
    print(f"\n{title}\n\n| column | {' | '.join(cells)} |\n|---{'|---' * len(cells)}|")
    for column, line in zip(SPACE.columns, zip(*cells.values(), strict=True), strict=True):
        if any(line):
            print(f"| {column} | {' | '.join(line)} |")


def tables(found: dict[str, list[Row]], mean: dict[str, FloatArray]) -> None:
    """AUCs, shares of NaN and numbers of features."""
    texts = {name: [signed(float(value)) for value in values] for name, values in mean.items()}
    for strength in STRENGTHS:
        print_table(f"Strength {strength:g}", {effect: texts.pop(f"{effect} {strength:g}") for effect in ROWS})
    print_table("Against other features, with other settings", texts)
    shares = {}
    for effect in ROWS[:-1]:
        of_row = [
            np.concatenate(phis) for phis in zip(*((r.affected, r.clean) for r in found[f"{effect} 1"]), strict=True)
        ]
        percent = [100.0 * np.isnan(phi).mean(axis=0) for phi in of_row]
        shares[effect] = [f"{a:.1f} / {c:.1f}" if a + c > 0 else "" for a, c in zip(*percent, strict=True)]
    print_table("Undefined among affected / clean features, %", shares)
    print("\n| | affected | clean |\n|---|---|---|")
    for name, group in found.items():
        print(f"| {name} | {sum(len(row.affected) for row in group)} | {sum(len(row.clean) for row in group)} |")
    for *_, name, column in REQUIRED:
        of_places = sorted(float(row.aucs[SPACE.columns.index(column)]) for row in found[name])
        print(f"{name}, {column}: " + ", ".join(f"{value:.3f}" for value in of_places))


def main() -> None:
    places = int(sys.argv[1]) if len(sys.argv) > 1 else 4
    folder = Path(sys.argv[2]) if len(sys.argv) > 2 else FOLDER
    with ProcessPoolExecutor(2) as pool:
        of_places = list(pool.map(place, range(places)))
    report({group[0].name: list(group) for group in zip(*of_places, strict=True)}, folder)


def report(found: dict[str, list[Row]], folder: Path) -> None:
    from separation_plots import heat_map, histograms  # here: they need this module

    mean = {name: np.mean([row.aucs for row in group], axis=0) for name, group in found.items()}
    tables(found, mean)
    heat_map(np.transpose([mean[f"{row} 1"] for row in ROWS]), folder / "separation.png")
    histograms(found, mean, folder / "separation_histograms.png")


if __name__ == "__main__":
    main()
