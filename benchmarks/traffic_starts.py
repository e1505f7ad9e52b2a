"""Start in rendered streets full of traffic, where the motion of vehicles may be taken for the
camera's.

    python benchmarks/traffic_starts.py [--seeds 8] [--every 2] [--traffic 0.8]

On motorways and in cities, vehicles drive ahead, beside and behind from the first frame on. Prints,
for each street: of the odometries that start at every second frame, how many take a wrong motion in
their first step; steps of a whole drive that are refused, the largest error of those that are OK,
and the error at the end. Then, of all pairs of a right and a wrong motion that many tracks agree
on, from whichever start, for how many the right one has more tracks, and for how many it outranks
the wrong one (``estimation.rival_motion``).
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

import probevo as pv
from probevo.arrays import FloatArray
from probevo.config import OdometryConfig
from probevo.estimation.motion_estimate import Status
from probevo.estimation.motion_model import MotionModel
from probevo.estimation.ransac import InlierThreshold, find_consensus
from probevo.estimation.rival_motion import Hypothesis, outranks
from probevo.geometry import se3
from probevo.sequences.frame import Frame
from probevo.sequences.recording import StereoRecording
from probevo.tracking import ImageTracker, TrackingState
from probevo_sim.scene.config import Effects, PresetName, SceneConfig
from probevo_sim.scene.writer import write_scene

DISTANCE_M: dict[PresetName, float] = {"road": 120.0, "city": 40.0}
FIRST_SEED = 41
WRONG_FROM = 0.2
"""Error of a translation, as a share of its length, from which on it is another motion's."""
MIN_ERROR_M = 0.1
THRESHOLD_PX = 2.0
AGAINST_PX = 6.0


class Street(NamedTuple):
    """A rendered drive."""

    recording: StereoRecording
    frames: list[Frame]
    truth: FloatArray
    """T_world_cam, [K, 4, 4]."""

    def motion(self, index: int) -> FloatArray:
        """Return the true T_curr_prev from a frame to the next, [4, 4]."""
        return np.asarray(se3.inverse(self.truth[index + 1]) @ self.truth[index])

    def is_right(self, T_curr_prev: FloatArray, index: int) -> bool:
        """Return whether a motion is that of the camera from a frame to the next."""
        true_m = self.motion(index)[:3, 3]
        error_m = float(np.linalg.norm(T_curr_prev[:3, 3] - true_m))
        return error_m <= max(MIN_ERROR_M, WRONG_FROM * float(np.linalg.norm(true_m)))


def rendered(preset: PresetName, seed: int, traffic: float, folder: Path) -> Street:
    """Render a drive into a folder."""
    config = SceneConfig(
        preset=preset, seed=seed, distance_m=DISTANCE_M[preset], effects=Effects(traffic=traffic)
    )
    path = folder / f"{preset}-{seed}"
    write_scene(config, path)
    recording = pv.open_sequence(path)
    if not isinstance(recording, StereoRecording) or recording.truth is None:
        raise TypeError(f"{path} is not rendered")
    return Street(recording, list(recording), np.asarray(recording.truth.T_world_cam))


def wrong_starts(street: Street, every: int) -> tuple[int, int]:
    """Return how many odometries take a wrong motion in their first step, and their number."""
    starts = range(0, len(street.frames) - 1, every)
    wrong = 0
    for index in starts:
        odometry = pv.StereoOdometry(street.recording.camera)
        odometry.step(street.frames[index])
        motion = odometry.step(street.frames[index + 1])
        wrong += not street.is_right(motion.T_curr_prev, index)
    return wrong, len(starts)


def driven(street: Street) -> str:
    """Return steps refused, the largest error of those that are OK, and the error at the end."""
    odometry = pv.StereoOdometry(street.recording.camera)
    motions = [odometry.step(frame) for frame in street.frames]
    errors_m = [
        np.linalg.norm(motion.T_curr_prev[:3, 3] - street.motion(index)[:3, 3])
        for index, motion in enumerate(motions[1:])
        if motion.status is Status.OK
    ]
    end = se3.inverse(street.truth[0]) @ street.truth[-1]
    end_error_m = np.linalg.norm(motions[-1].T_world_cam[:3, 3] - end[:3, 3])
    num_refused = len(motions) - 1 - len(errors_m)
    return f"{num_refused:8} {max(errors_m):13.2f} {end_error_m:8.2f}"


class Ranked(NamedTuple):
    """A right and a wrong motion that many tracks agree on."""

    has_more_tracks: bool
    """Whether the right one has."""
    outranks: bool
    """Whether the right one does."""


def ranked(street: Street, index: int) -> list[Ranked]:
    """Return all pairs of motions of which one is right, between a frame and the next."""
    config = OdometryConfig()
    camera = street.recording.camera
    tracker = ImageTracker(camera, config.tracking_of_estimator)
    model = MotionModel.at_start(config.motion_model)
    step_s = 1e-9 * (street.frames[index + 1].stamp_ns - street.frames[index].stamp_ns)
    state = tracker.track(TrackingState.none(), street.frames[index], np.eye(4)).state
    right: list[Hypothesis] = []
    wrong: list[Hypothesis] = []
    for start in model.starts(step_s, model.predict(step_s, None)):
        tracks = tracker.follow(state, street.frames[index + 1], start).tracks
        found = find_consensus(
            tracks,
            camera,
            np.random.default_rng(0),
            guess=start,
            threshold=InlierThreshold(THRESHOLD_PX),
        )
        motion = Hypothesis(found.T_curr_prev, tracks.subset(found.inliers))
        (right if street.is_right(found.T_curr_prev, index) else wrong).append(motion)
    fewest = config.solver.min_tracks_beyond_chance
    pairs = []
    for one in right:
        for other in wrong:
            of_right = len(one.contradicting(other.T_curr_prev, camera, AGAINST_PX))
            of_wrong = len(other.contradicting(one.T_curr_prev, camera, AGAINST_PX))
            if min(of_right, of_wrong) >= fewest:
                wins = outranks(one, other, camera, fewest=fewest, against_px=AGAINST_PX)
                pairs.append(Ranked(of_right > of_wrong, wins))
    return pairs


def main() -> None:
    """Parse the command line, and print a line for each street."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--every", type=int, default=2)
    parser.add_argument("--traffic", type=float, default=0.8)
    arguments = parser.parse_args()
    print("street   seed  wrong starts  refused  worst OK, m   end, m")
    pairs: list[Ranked] = []
    for preset in DISTANCE_M:
        for seed in range(FIRST_SEED, FIRST_SEED + arguments.seeds):
            with tempfile.TemporaryDirectory() as folder:
                street = rendered(preset, seed, arguments.traffic, Path(folder))
                wrong, count = wrong_starts(street, arguments.every)
                print(f"{preset:8} {seed:4} {wrong:6} of {count:3} {driven(street)}", flush=True)
                for index in range(0, len(street.frames) - 1, arguments.every):
                    pairs += ranked(street, index)
    more = sum(pair.has_more_tracks for pair in pairs)
    higher = sum(pair.outranks for pair in pairs)
    print(
        f"of {len(pairs)} pairs, the right motion has more tracks in {more}, outranks in {higher}"
    )


if __name__ == "__main__":
    main()
