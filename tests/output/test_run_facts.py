"""What the facts of a run say of the rig."""

from dataclasses import replace

import numpy as np
import pytest

import probevo as pv
from probevo.camera.focal_length import FocalLengthError
from probevo.measurements.imu_reason import ImuFault, ImuReason
from probevo.output.run_facts import (
    camera_text,
    delay_text,
    feature_noise_text,
    focal_text,
    imu_noise_text,
    readout_text,
    unused_imu_text,
)
from probevo.output.run_result import RunRecorder


@pytest.mark.parametrize(
    ("delay_s", "text"), [(0.0049, "4.9 ms later"), (-0.002, "2.0 ms earlier")]
)
def test_the_delay_is_said_with_its_sign(delay_s: float, text: str) -> None:
    assert f"right images are exposed {text} than left ones" in delay_text(delay_s)


def test_a_camera_is_described_with_the_readout_of_its_calibration() -> None:
    camera = pv.StereoCamera.centered(200.0, 0.1, (320, 240))
    text = "320×240 px, f 200.0 px, baseline 0.1000 m, 77° wide"
    assert camera_text(camera) == text
    rolling = replace(camera, readout_s=0.0249)
    assert camera_text(rolling) == f"{text}, rows exposed within 24.9 ms"


def test_a_rolling_shutter_is_said_with_its_direction() -> None:
    assert "within 25 ms, from the first to the last" in readout_text(0.0249)
    assert "within 8 ms, from the last to the first" in readout_text(-0.008)


def test_the_focal_length_is_said_with_its_sigma() -> None:
    unknown = focal_text(FocalLengthError(-0.02, 0.01))
    assert unknown.startswith("as calibrated, within what is noticed")
    assert unknown.endswith("a difference of -1.98 ± 1.00 %")
    assert "is 1.98 % shorter than calibrated (σ = 0.300 %)" in focal_text(
        FocalLengthError(-0.02, 0.003)
    )


def test_noise_of_the_imu_is_told_as_a_factor_of_sigma() -> None:
    assert imu_noise_text(1.2) == "as calibrated, as far as the images show it"
    assert imu_noise_text(6.25).startswith("2.5 times as large as calibrated")


def test_noise_of_the_features_in_words() -> None:
    """By σ, of the median step: the factors are those of variances."""
    assert feature_noise_text(np.array([1.0, 0.9, 1.2])) == "as the noise model says"
    text = feature_noise_text(np.array([1.0, 0.25, 0.25]))
    assert text.startswith("0.50 times as large as the noise model says")


def test_why_the_imu_was_not_used_is_counted() -> None:
    recorder = RunRecorder()
    faults = [None, ImuFault.HOLE, ImuFault.GATED, ImuFault.HOLE, None]
    for frame, fault in enumerate(faults):
        motion = pv.MotionEstimate(
            np.eye(4),
            np.eye(6),
            pv.Status.OK if frame else pv.Status.FIRST,
            num_tracks=0,
            imu_reason=None if fault is None else ImuReason(fault, "…"),
        )
        recorder.add(frame, motion, imu_is_in_window=True)
    assert unused_imu_text(recorder.result()) == "not used in 3 of 4 steps (2 hole, 1 gated)"
    assert unused_imu_text(RunRecorder().result()) == ""
