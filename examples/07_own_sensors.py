"""Plug in sensors of one's own: a heading from GPS, with dropouts, and the way from the wheels.

python examples/07_own_sensors.py TRACKS      e.g. test.npz of `probevo simulate point --out DIR`
"""

import sys

import numpy as np

import probevo as pv
from probevo.measurements import Heading, NoMeasurement, TravelledDistance, pose_of
from probevo.output.run_result import RunRecorder

HEADING_SIGMA = np.deg2rad(2.0)


def main(path: str) -> None:
    """Compare the heading with and without the sensors, which measure the truth with noise."""
    sequence = pv.open_sequence(path)
    truth = sequence.truth.T_world_cam
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(len(truth), 2))

    def gps(prev_frame, frame):
        """Heading from that of the first camera, but under a bridge every now and then."""
        if frame.index % 50 > 30:
            return NoMeasurement("no fix")
        ahead = truth[frame.index, :3, 2]
        heading = np.arctan2(ahead[0], ahead[2]) + HEADING_SIGMA * noise[frame.index, 0]
        return [Heading(pose_of(frame.index), heading, HEADING_SIGMA)]

    def wheels(prev_frame, frame):
        """Travelled distance along the optical axis since the previous frame, to 2 %."""
        way = (
            truth[prev_frame.index, :3, :3].T
            @ (truth[frame.index] - truth[prev_frame.index])[:3, 3]
        )
        distance = way[2] * (1.0 + 0.02 * noise[frame.index, 1])
        curr, prev = pose_of(frame.index), pose_of(prev_frame.index)
        return [TravelledDistance(distance, 0.02 * abs(distance) + 1e-3, curr, prev)]

    # Headings are fused with the path of two frames; with that of a window they gain less.
    config = {"estimator": "two-frame"}
    for sensors in ([], [gps, wheels]):
        odometry = pv.StereoOdometry(sequence.camera, config=config, sensors=sensors)
        recorder = RunRecorder()
        for frame in sequence:
            estimate = odometry.step(frame)
            recorder.add(frame.stamp_ns, estimate)
        off = estimate.T_world_cam[:3, :3] @ truth[-1, :3, :3].T
        sigma = np.sqrt(estimate.cov_cam_world[4, 4])
        names = " and ".join(sensor.__name__ for sensor in sensors) or "no sensor"
        turn = np.rad2deg(np.arctan2(off[0, 2], off[2, 2]))
        print(f"{names}: heading off by {turn:.2f}° at the end, claimed ± {np.rad2deg(sigma):.2f}°")
        for name, use in recorder.result().sensors.items():
            print(f"  {name}: {use}")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        print("usage: python examples/07_own_sensors.py TRACKS", file=sys.stderr)
        sys.exit(2)
    main(sys.argv[1])
