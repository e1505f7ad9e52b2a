"""Hold the errors of tracked features on real images against their noise: docs/accuracy.md.

    python benchmarks/flow_truth.py [--noise student-t MODEL.safetensors …] [--features 800]
        [--scenes FOLDER]

Scenes of KITTI 2012 or 2015 with true disparity and flow. The odometry runs up to frame 11; the
features that it followed from frame 10 are compared with the truth there: flow (u, v) and disparity
at frame 10. Prints their errors, the truth's own σ, and the share of the errors inside of their 50,
90 and 99 % regions under each noise model: as it is, with the truth's own σ added, and for the
difference of neighbouring features, in which errors that these have in common cancel.

The truth's own σ is the part of the errors that neighbouring features have in common, whose windows
do not overlap: it comes from the LiDAR, its calibration and registration, or from the calibration
of the cameras, and not from the features.

Without --noise: fixed, student-t, and a Student-t and a kernel that are learned from raw 0005.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from recordings import RECORDINGS, ROOT

import probevo as pv
from probevo.arrays import FloatArray
from probevo.noise.named import noise_model
from probevo.sequences.formats.kitti_flow import (
    TRUTH_FRAME,
    FlowTruth,
    read_flow_truth,
    scene_numbers,
)

HALF_PX = 4
"""Half a window of the truth, to which a plane is fitted."""
MIN_KNOWN = 20
"""Pixels of it that have to be known."""
MAX_ROUGH_PX = 0.5
"""The truth is that of one surface where it deviates from the plane by less (RMS)."""
NEIGHBOURS_PX = (12.0, 40.0)
"""Distance of neighbouring features: their windows, of 11 px, do not overlap."""
SAME_SURFACE_PX = 2.0
"""Largest difference of the disparities of neighbours."""
PERCENT = (50, 90, 99)
DRAWS = 4000
"""Simulated errors of each feature."""
# Errors of (flow u, flow v, disparity) by those of (u_l, v_l, u_r, v_r) at frames 11 and 10.
BY_CURR = np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 0, 0]])
BY_PREV = np.array([[-1.0, 0, 0, 0], [0, -1.0, 0, 0], [1.0, 0, -1.0, 0]])
DISPARITY = 2


@dataclass(frozen=True)
class Features:
    """N features on one surface each, whose truth is known."""

    error_px: FloatArray
    """Of flow (u, v) and disparity, [N, 3]."""
    place: FloatArray
    """(u, v, true disparity, 10⁶ times the number of the scene), [N, 4]."""
    rough_px: FloatArray
    """RMS deviation of the truth around each from a plane, [N, 3]."""
    scale: FloatArray
    """Scale matrix of the predicted noise of the error, [N, 3, 3], px²."""
    dof: FloatArray
    """Its degrees of freedom, [N]."""


def plane_at(truth: FloatArray, u: float, v: float) -> tuple[float, float] | None:
    """Fit a plane to the truth around (u, v), [height, width].

    Returns:
        Its value there and the RMS deviation from it; None where too little is known.
    """
    row = round(v)
    column = round(u)
    window = truth[
        max(row - HALF_PX, 0) : row + HALF_PX + 1, max(column - HALF_PX, 0) : column + HALF_PX + 1
    ]
    known = np.argwhere(np.isfinite(window))
    if len(known) < MIN_KNOWN:
        return None
    rows, columns = known.T
    place = np.column_stack(
        [
            np.ones(len(known)),
            columns + max(column - HALF_PX, 0) - u,
            rows + max(row - HALF_PX, 0) - v,
        ]
    )
    values = window[rows, columns]
    solution = np.linalg.lstsq(place, values, rcond=None)[0]
    rough = np.sqrt(np.sum((values - place @ solution) ** 2) / (len(known) - 3))
    return float(solution[0]), float(rough)


def features_of(folder: Path, scene: int, noise: str, num_features: int) -> Features:
    """Run the odometry up to frame 11 of a scene, and compare its features with the truth."""
    sequence = pv.open_sequence(folder, scene=scene)
    config = pv.OdometryConfig(estimator="two-frame", tracking={"num_features": num_features})
    odometry = pv.StereoOdometry(sequence.camera, noise_model(noise), config=config)
    period_ns = int(np.diff(sequence.stamps_ns).min())
    for frame in sequence:
        odometry.step(frame)
        if round(frame.stamp_ns / period_ns) == TRUTH_FRAME + 1:
            break
    truth = read_flow_truth(folder, scene)
    tracks = odometry.tracks
    predicted = odometry.noise.predict(odometry.phi)
    scale = BY_CURR @ predicted.scale @ BY_CURR.T + BY_PREV @ predicted.scale @ BY_PREV.T
    if predicted.time_correlated is not None:
        scale[:, DISPARITY, DISPARITY] += predicted.time_correlated
    found = [truth_at(truth, float(u), float(v)) for u, v in tracks.prev_px[:, :2]]
    kept = [k for k, each in enumerate(found) if each is not None and max(each[1]) < MAX_ROUGH_PX]
    true = np.array([found[k][0] for k in kept]).reshape(-1, 3)
    measured = np.column_stack(
        [
            tracks.curr_px[:, :2] - tracks.prev_px[:, :2],
            tracks.prev_px[:, 0] - tracks.prev_px[:, 2],
        ]
    )
    return Features(
        error_px=measured[kept] - true,
        place=np.column_stack(
            [tracks.prev_px[kept, :2], true[:, DISPARITY], np.full(len(kept), 1e6 * scene)]
        ),
        rough_px=np.array([found[k][1] for k in kept]).reshape(-1, 3),
        scale=scale[kept],
        dof=predicted.dof[kept],
    )


def truth_at(
    truth: FlowTruth, u: float, v: float
) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
    """Return the true (flow u, flow v, disparity) at a place, and how rough each is around it."""
    quantities = (truth.flow_px[..., 0], truth.flow_px[..., 1], truth.disparity_px)
    planes = [plane_at(each, u, v) for each in quantities]
    if any(plane is None for plane in planes):
        return None
    values, rough = zip(*planes, strict=True)
    return values, rough


def joined(parts: list[Features]) -> Features:
    return Features(
        error_px=np.concatenate([part.error_px for part in parts]),
        place=np.concatenate([part.place for part in parts]),
        rough_px=np.concatenate([part.rough_px for part in parts]),
        scale=np.concatenate([part.scale for part in parts]),
        dof=np.concatenate([part.dof for part in parts]),
    )


def coverage(features: Features, truth_sigma_px: FloatArray) -> list[float]:
    """Return the share of the errors inside of their regions, %, the truth's own σ, [3], added.

    The error is the sum of a Student-t and, for the truth, a normal vector. The distribution of its
    squared Mahalanobis distance is simulated for each feature.
    """
    rng = np.random.default_rng(0)
    levels = []
    for k, error in enumerate(features.error_px):
        drawn = drawn_errors(features, k, rng)
        drawn += truth_sigma_px * rng.standard_normal((DRAWS, 3))
        cov = features.scale[k] + np.diag(truth_sigma_px**2)
        levels.append(level_of(error, drawn, cov))
    return shares(levels)


def coverage_of_differences(features: Features) -> list[float]:
    """Return the same share for the difference of each feature's error and its neighbour's."""
    rng = np.random.default_rng(0)
    levels = []
    for k, other in nearest_neighbours(features):
        difference = features.error_px[k] - features.error_px[other]
        drawn = drawn_errors(features, k, rng) + drawn_errors(features, other, rng)
        levels.append(level_of(difference, drawn, features.scale[k] + features.scale[other]))
    return shares(levels)


def drawn_errors(features: Features, k: int, rng: np.random.Generator) -> FloatArray:
    """Draw errors of a feature from its predicted Student-t, [DRAWS, 3], px."""
    drawn = rng.multivariate_normal(np.zeros(3), features.scale[k], size=DRAWS)
    dof = features.dof[k]
    if np.isfinite(dof):
        drawn /= np.sqrt(rng.chisquare(dof, DRAWS) / dof)[:, None]
    return drawn


def level_of(error: FloatArray, drawn: FloatArray, cov: FloatArray) -> float:
    """Return the share of the drawn errors whose squared Mahalanobis distance is smaller."""
    information = np.linalg.inv(cov)
    squared = np.einsum("ni,ij,nj->n", drawn, information, drawn)
    return float(np.mean(squared <= error @ information @ error))


def shares(levels: list[float]) -> list[float]:
    return [100.0 * float(np.mean(np.array(levels) <= percent / 100.0)) for percent in PERCENT]


def nearest_neighbours(features: Features) -> list[tuple[int, int]]:
    """Return pairs of neighbours on the same surface, each feature at most once."""
    first, second, distance = neighbours(features)
    taken: set[int] = set()
    pairs = []
    for k in np.argsort(distance):
        pair = (int(first[k]), int(second[k]))
        if not taken & set(pair):
            taken |= set(pair)
            pairs.append(pair)
    return pairs


def neighbours(features: Features) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return both indices of all pairs of neighbours on the same surface, and their distances."""
    first, second = np.triu_indices(len(features.place), k=1)
    apart = np.abs(features.place[first] - features.place[second])
    distance = np.hypot(apart[:, 0], apart[:, 1])
    is_near = (distance >= NEIGHBOURS_PX[0]) & (distance <= NEIGHBOURS_PX[1])
    is_near &= (apart[:, 2] < SAME_SURFACE_PX) & (apart[:, 3] == 0.0)
    return first[is_near], second[is_near], distance[is_near]


def sigma_of(errors: FloatArray) -> FloatArray:
    """Return the robust standard deviation of each column, [N, C]: [C]."""
    return 1.4826 * np.median(np.abs(errors - np.median(errors, axis=0)), axis=0)


def truth_sigma(features: Features) -> FloatArray:
    """Return the standard deviation of what neighbours have in common, [3], px."""
    first, second, _ = neighbours(features)
    difference = features.error_px[first] - features.error_px[second]
    # Half of the variance of a difference is what is new in each feature.
    new = 1.4826 * np.median(np.abs(difference), axis=0) / np.sqrt(2.0)
    all_of_it = 1.4826 * np.median(np.abs(features.error_px), axis=0)
    return np.sqrt(np.maximum(all_of_it**2 - new**2, 0.0))


def main() -> None:
    """Parse the command line, and print a table of all noise models."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--noise", nargs="+")
    parser.add_argument("--features", type=int, default=800)
    parser.add_argument("--scenes", type=Path, default=ROOT / "kitti_2012")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    with TemporaryDirectory() as folder:
        noises = given.noise or ["fixed", "student-t", *learned(Path(folder))]
        report(noises, given.scenes, given.features)


def learned(folder: Path) -> list[str]:
    """Learn a Student-t and a kernel from raw 0005, without ground truth; return their files."""
    files = []
    for kind in ("student-t", "gk"):
        file = folder / f"learned-{kind}.safetensors"
        settings = pv.TrainSettings(kind=kind, supervision="none")
        pv.train_model([RECORDINGS["raw 0005"]], settings, file)
        files.append(str(file))
    return files


def report(noises: list[str], scenes: Path, num_features: int) -> None:
    """Print the table of all noise models, and the errors under the last one."""
    print(
        "| noise | features | 50 / 90 / 99 % hold, % | with the truth's σ, %"
        " | differences of neighbours, % |"
    )
    print("|---|---|---|---|---|")
    for noise in noises:
        parts = [features_of(scenes, scene, noise, num_features) for scene in scene_numbers(scenes)]
        features = joined(parts)
        truth_sigma_px = truth_sigma(features)
        alone = " / ".join(f"{share:.0f}" for share in coverage(features, np.zeros(3)))
        both = " / ".join(f"{share:.0f}" for share in coverage(features, truth_sigma_px))
        pairs = " / ".join(f"{share:.0f}" for share in coverage_of_differences(features))
        name = Path(noise).stem
        print(f"| {name} | {len(features.error_px)} | {alone} | {both} | {pairs} |", flush=True)
    print()
    for scene, part in zip(scene_numbers(scenes), parts, strict=True):
        print_errors(f"scene {scene}", part)
    print_errors("all", features)


def print_errors(name: str, features: Features) -> None:
    """Print median and scatter of the errors, and the roughness of the truth."""
    median = np.median(features.error_px, axis=0)
    sigma = sigma_of(features.error_px)
    own = truth_sigma(features)
    for k, what in enumerate(("flow u", "flow v", "disparity")):
        print(
            f"{name}, {what}: {median[k]:+.2f} ± {sigma[k]:.2f} px (median, robust σ);"
            f" σ of the truth {own[k]:.2f} px"
        )


if __name__ == "__main__":
    main()
