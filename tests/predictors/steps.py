"""A step with images and IMU, and predictors of one's own, for the tests of the space."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.predictors import Needs, Predictor, Step
from probevo.sequences.frame import Frame, ImuSamples
from worlds import CAMERA, FORWARD, FRAME_NS, seen_twice

COUNT = 20
IMAGE = np.random.default_rng(0).integers(0, 256, (370, 1226), dtype=np.uint8)
IMU = ImuSamples(
    stamps_ns=np.arange(0, FRAME_NS + 1, FRAME_NS // 20),
    gyro_rad_s=np.zeros((21, 3)),
    accel_m_s2=np.tile([0.0, -9.81, 0.0], (21, 1)),
)
STEP = Step(
    tracks=replace(
        seen_twice(np.random.default_rng(1), COUNT),
        difference=np.ones((COUNT, 2)),
        alignment_cov_px2=np.tile(np.eye(2), (COUNT, 2, 1, 1)),
    ),
    camera=CAMERA,
    predicted_T_curr_prev=FORWARD,
    prev_frame=Frame(0, 0, IMAGE, right=IMAGE),
    curr_frame=Frame(1, FRAME_NS, IMAGE, right=IMAGE, imu=IMU),
)


def own(
    name: str,
    compute: Callable[[Step], FloatArray],
    *columns: str,
    needs: Needs = Needs.TRACKS,
    undefined: str = "",
) -> Predictor:
    """A predictor whose only column has its own name, unless others are given."""
    return Predictor(
        name=name,
        columns=dict.fromkeys(columns or (name,), "1"),
        source="test",
        needs=needs,
        compute=compute,
        undefined=undefined,
    )


def ramp(step: Step) -> FloatArray:
    """0, 1, 2 …, [N]."""
    return np.arange(float(len(step.tracks)))
