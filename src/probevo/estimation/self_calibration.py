"""Self-calibration: the motion of a step and the rig's calibration, each of which needs the other.

The tracks are corrected by the calibration, and their residuals show what is left of its errors
(``estimation.rig_update``). Two of these errors are so large on some rigs that a step has to be
solved again once it has shown them:

- Jitter. Where the tracks show more of it than was expected, they are solved again with what they
  show, as they are in the first frames of a rig that is looser than the prior.
- Delay. Where right images are exposed at another time, where they would have been seen depends on
  the motion itself: the tracks are corrected by the motion that was found, and solved again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.exposure_delay import is_noticeable
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.stereo import StereoCamera
from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.estimation.motion_model import MotionModel, MotionPrediction
from probevo.estimation.rig_update import update_rig
from probevo.estimation.visual_motion import MotionPriors, VisualEstimator, VisualMotion
from probevo.geometry import se3
from probevo.stage_clock import StageClock
from probevo.tracking.corrected_tracks import CorrectedTracks

MOST_REPEATED_SOLVES = 3
"""How often a step is solved again, at most, because its tracks show more jitter of the rig."""


@dataclass(frozen=True)
class CalibratedMotion:
    """What the tracks of a step say of the motion and of the rig."""

    corrected: CorrectedTracks
    """The tracks as they were solved."""
    visual: VisualMotion
    rig: RigCalibration | None
    """The calibration after the step; None without self-calibration."""
    common_mode: FloatArray
    """Columns along which errors of the calibration before the step move the motion, [6, 3]."""
    jitter_cov: FloatArray | None
    """Covariance of the rig's jitter with which the tracks were solved, [3, 3], rad²; None without
    self-calibration."""

    def accepted(self) -> MotionEstimate:
        """Return the motion of an accepted solve.

        Raises:
            ValueError: there is none.
        """
        visual = self.visual
        solution = visual.accepted_solution
        return MotionEstimate(
            T_curr_prev=solution.T_curr_prev,
            # An error of the calibration is common to all features: no number of them averages it
            # out, and it comes on top (Schmidt's consider term).
            cov=solution.cov + self.common_mode @ self.common_mode.T,
            status=visual.status,
            num_tracks=len(self.corrected.tracks),
            num_inliers=visual.num_inliers,
            iterations=visual.num_iterations,
            common_mode=self.common_mode,
            path_cross_cov=visual.disparities.path_cross_cov,
            num_used=visual.num_used,
            num_out_of_domain=visual.num_out_of_domain,
        )

    def dead_reckoned(
        self, model: MotionModel, prediction: MotionPrediction, duration_s: float
    ) -> MotionEstimate:
        """Return the predicted motion, with its covariance, where the images fix none.

        Args:
            model: the motion model that predicted it.
            prediction: the motion of the step.
            duration_s: time between the two frames.
        """
        visual = self.visual
        reckoned = model.dead_reckoned(
            prediction, visual.solution, refused=visual.status is Status.NOT_CONVERGED
        )
        return MotionEstimate(
            T_curr_prev=reckoned.T_curr_prev,
            cov=reckoned.cov,
            status=Status.GAP if model.is_gap(duration_s) else visual.status,
            num_tracks=len(self.corrected.tracks),
            num_inliers=visual.num_inliers,
            iterations=visual.num_iterations,
            path_cross_cov=reckoned.path_cross_cov,
            num_used=visual.num_used,
            num_out_of_domain=visual.num_out_of_domain,
        )


class SelfCalibratingEstimator:
    """The visual estimator, with the rig's calibration updated by what it solves.

    Args:
        camera: the rectified camera.
        visual: estimates the motion of corrected tracks.
    """

    def __init__(self, camera: StereoCamera, visual: VisualEstimator) -> None:
        self._camera = camera
        self._visual = visual

    def estimate(
        self,
        corrected: CorrectedTracks,
        phi: FloatArray,
        priors: MotionPriors,
        *,
        last_twist_s: FloatArray,
        duration_s: float,
        seed: Sequence[int],
        clock: StageClock,
    ) -> CalibratedMotion:
        """Estimate the motion of N tracks, and update the rig's calibration.

        Args:
            corrected: the N tracks.
            phi: their places in the prediction space, [N, M].
            priors: knowledge of the step before its tracks.
            last_twist_s: twist a second of the step before, [6].
            duration_s: time between the two frames.
            seed: of RANSAC's samples, which are those of the frame in every solve.
            clock: takes the times of the stages ``consensus`` and ``solve``.
        """
        found = self._with_jitter(corrected, phi, priors, seed=seed, clock=clock)
        if found.visual.status is Status.OK and is_noticeable(corrected.delay_s):
            twist_s = se3.log(found.visual.accepted_solution.T_curr_prev) / duration_s
            # The twist is the mean of a step; at its ends there is half of the change.
            corrected = corrected.at_twists(
                0.5 * (last_twist_s + twist_s), 1.5 * twist_s - 0.5 * last_twist_s, self._camera
            )
            found = self._with_jitter(corrected, phi, priors, seed=seed, clock=clock)
        if found.visual.status is not Status.OK:
            # Rows need no motion; all else would be learned from one that was not accepted.
            return replace(found, rig=corrected.rig)
        return replace(found, rig=self._with_delay(found, duration_s))

    def _with_jitter(
        self,
        corrected: CorrectedTracks,
        phi: FloatArray,
        priors: MotionPriors,
        *,
        seed: Sequence[int],
        clock: StageClock,
    ) -> CalibratedMotion:
        """Estimate the motion under the jitter that the tracks show; the delay is not updated."""
        rig = corrected.rig
        jitter_cov = None if rig is None else rig.jitter.cov
        for _ in range(1 + MOST_REPEATED_SOLVES):
            visual = self._visual.estimate(
                corrected.tracks,
                phi,
                replace(priors, jitter_cov=jitter_cov),
                rng=np.random.default_rng(seed),
                clock=clock,
            )
            if rig is None or visual.two_frames_only is None:
                return CalibratedMotion(
                    corrected, visual, rig=rig, common_mode=np.zeros((6, 3)), jitter_cov=jitter_cov
                )
            used = corrected.tracks.kept(visual.used)
            updated, common_mode = update_rig(rig, used, visual.two_frames_only, self._camera)
            if not updated.jitter.exceeds(jitter_cov):
                break
            jitter_cov = updated.jitter.cov
        return CalibratedMotion(
            corrected, visual, rig=updated, common_mode=common_mode, jitter_cov=jitter_cov
        )

    def _with_delay(self, found: CalibratedMotion, duration_s: float) -> RigCalibration | None:
        """Return the calibration after an accepted solve, with the delay of the right images."""
        visual = found.visual
        if found.rig is None or visual.two_frames_only is None:
            return found.rig
        rig = found.rig.with_delay(
            found.corrected.raw.curr_px[visual.used],
            se3.log(visual.accepted_solution.T_curr_prev) / duration_s,
            self._camera,
        )
        prior = found.corrected.prior_rig
        if prior is not None and rig.delay.differs_from(found.corrected.delay_s):
            # The tracks were those of another delay, and teach nothing but the delay.
            return replace(prior, delay=rig.delay)
        return rig
