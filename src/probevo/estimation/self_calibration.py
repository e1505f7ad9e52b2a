"""Self-calibration: the motion of a step and the rig's calibration, each of which depends on the
other.

Tracks are corrected by the calibration, and the residuals of the solve reveal its remaining errors
(``estimation.rig_update``). On some rigs, two of these errors are so large that the step is solved
again once they are known:

- Jitter. If the tracks show more jitter than expected, they are solved again with the larger
  covariance, as in the first frames of a rig that flexes more than the prior.
- Times. If the right camera is exposed at another time than the left one, or rows at other times
  than the middle one, the correction depends on the motion: the tracks are corrected with the
  solved motion, and solved again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.exposure_delay import is_noticeable
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.rolling_shutter import Twists
from probevo.camera.stereo import StereoCamera
from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.estimation.motion_model import MotionModel, MotionPrediction
from probevo.estimation.reprojection import ReprojectionSolution
from probevo.estimation.rig_update import CommonMode, update_rig
from probevo.estimation.visual_motion import MotionPriors, VisualEstimator, VisualMotion
from probevo.geometry import se3
from probevo.stage_clock import StageClock
from probevo.tracking.corrected_tracks import CorrectedTracks

MAX_REPEATED_SOLVES = 3
"""Largest number of repeated solves because of more jitter than expected."""


@dataclass(frozen=True)
class CalibratedMotion:
    """The motion of a step by its tracks, and the calibration of the rig after it."""

    corrected: CorrectedTracks
    """The tracks as they were solved."""
    visual: VisualMotion
    rig: RigCalibration | None
    """The calibration after the step; None without self-calibration."""
    of_images: CommonMode
    """How errors of the calibration before the step move its motion by the images alone."""
    common_mode: CommonMode
    """How they move the solved motion, which other measurements hold."""
    jitter_cov: FloatArray | None
    """Covariance of the rig's jitter that the solve assumed, [3, 3], rad²; None without any."""

    def accepted(self) -> MotionEstimate:
        """Return the motion of an accepted solve.

        Raises:
            ValueError: there is none.
        """
        visual = self.visual
        solution = visual.accepted_solution
        common_mode = self.common_mode.columns
        return MotionEstimate(
            T_curr_prev=solution.T_curr_prev,
            # An error of the calibration is the same for all features and does not average out:
            # add Schmidt's consider term.
            cov=solution.cov + common_mode @ common_mode.T,
            status=visual.status,
            num_tracks=len(self.corrected.tracks),
            num_inliers=visual.num_inliers,
            iterations=visual.num_iterations,
            common_mode=common_mode,
            path_cross_cov=visual.disparities.path_cross_cov,
            num_used=visual.num_used,
            num_out_of_domain=visual.num_out_of_domain,
        )

    def dead_reckoned(
        self, model: MotionModel, prediction: MotionPrediction, duration_s: float
    ) -> MotionEstimate:
        """Return the predicted motion and its covariance, for a step without an accepted solve.

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
    """The visual estimator together with online calibration of the rig.

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
        last_twist: FloatArray,
        duration_s: float,
        seed: Sequence[int],
        clock: StageClock,
    ) -> CalibratedMotion:
        """Estimate the motion of N tracks, and update the rig's calibration.

        Args:
            corrected: the N tracks.
            phi: the predictors of these tracks, [N, M].
            priors: what is known about the step before its tracks are used.
            last_twist: twist per second of the previous step, [6].
            duration_s: time between the two frames.
            seed: of RANSAC's samples; every repeated solve draws the same ones.
            clock: takes the times of the stages ``consensus`` and ``solve``.
        """
        last = last_twist if corrected.knows_velocity else None
        found = self._solve_until_jitter_fits(
            corrected, phi, priors, last, duration_s, seed=seed, clock=clock
        )
        if found.visual.status is Status.OK and _depends_on_velocity(corrected.rig):
            twists = _twists(found.visual.accepted_solution, last, duration_s)
            corrected = corrected.at_twists(twists, self._camera)
            found = self._solve_until_jitter_fits(
                corrected, phi, priors, last, duration_s, seed=seed, clock=clock
            )
        if found.visual.status is not Status.OK:
            # Keep the row offsets, which need no motion, and discard all else: the motion that it
            # depends on was rejected.
            return replace(found, rig=corrected.rig)
        return replace(found, rig=self._rig_with_delay(found, duration_s))

    def _solve_until_jitter_fits(
        self,
        corrected: CorrectedTracks,
        phi: FloatArray,
        priors: MotionPriors,
        last_twist: FloatArray | None,
        duration_s: float,
        *,
        seed: Sequence[int],
        clock: StageClock,
    ) -> CalibratedMotion:
        """Solve, repeatedly if the tracks show more jitter than assumed; the delay is not
        updated."""
        rig = corrected.rig
        jitter_cov = None if rig is None else rig.jitter.cov
        for repeats_left in reversed(range(1 + MAX_REPEATED_SOLVES)):
            visual = self._visual.estimate(
                corrected.tracks,
                phi,
                replace(priors, jitter_cov=jitter_cov),
                rng=np.random.default_rng(seed),
                clock=clock,
            )
            if rig is None or visual.two_frames_only is None:
                learned = None if visual.noise is None else visual.noise.jitter_cov
                return CalibratedMotion(
                    corrected,
                    visual,
                    rig=rig,
                    of_images=CommonMode.none(),
                    common_mode=CommonMode.none(),
                    jitter_cov=learned if rig is None else jitter_cov,
                )
            # What the solve shows of the rig; solve again if that is more jitter than the solve
            # assumed.
            used = corrected.tracks.subset(visual.used)
            two_frames = visual.two_frames_only
            updated, of_images = update_rig(
                rig,
                used,
                two_frames,
                self._camera,
                _twists(two_frames, last_twist, duration_s),
            )
            if not repeats_left or not updated.jitter.exceeds(jitter_cov):
                break
            jitter_cov = updated.jitter.cov
        return CalibratedMotion(
            corrected,
            visual,
            rig=updated,
            of_images=of_images,
            common_mode=_held_by(priors, visual.solution, of_images),
            jitter_cov=jitter_cov,
        )

    def _rig_with_delay(self, found: CalibratedMotion, duration_s: float) -> RigCalibration | None:
        """Return the calibration after an accepted solve, with the exposure delay updated."""
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
            # The tracks were corrected with a delay that turned out to be wrong. Keep nothing but
            # the new delay.
            return replace(prior, delay=rig.delay)
        return rig


def _depends_on_velocity(rig: RigCalibration | None) -> bool:
    """Return whether the correction of the tracks depends on the velocity of the camera."""
    if rig is None:
        return False
    return is_noticeable(rig.delay.delay_s) or rig.image.readout_s != 0.0


def _twists(
    solution: ReprojectionSolution, last_twist: FloatArray | None, duration_s: float
) -> Twists:
    """Return the velocities at the two frames of a step.

    A twist is the mean velocity of a step; those of the last step and of this one are interpolated
    to the frames.

    Args:
        solution: the motion of the step.
        last_twist: twist per second of the previous step, [6]; None if it is not known, and that of
            this step stands for both.
        duration_s: time between the two frames.
    """
    twist = se3.log(solution.T_curr_prev) / duration_s
    twist_change = np.zeros(6) if last_twist is None else twist - last_twist
    return Twists(prev=twist - 0.5 * twist_change, curr=twist + 0.5 * twist_change)


def _held_by(
    priors: MotionPriors, solution: ReprojectionSolution | None, of_images: CommonMode
) -> CommonMode:
    """Return how errors of the calibration move a motion that other measurements hold.

    With H U₀ = C of the images alone and P⁻¹ = H + Σ Jᵀ R⁻¹ J of the solve, U = P C is
    (1 − P Σ Jᵀ R⁻¹ J) U₀.

    Args:
        priors: with these measurements.
        solution: the solve; None if it is degenerate.
        of_images: U₀.
    """
    if solution is None or not priors.measurements:
        return of_images
    values = {variable: np.eye(4) for one in priors.measurements for variable in one.variables}
    values[priors.curr] = solution.T_curr_prev
    information = np.zeros((6, 6))
    for one in priors.measurements:
        start = 6 * one.variables.index(priors.curr)
        of_pose = slice(start, start + 6)
        information += one.information(values)[of_pose, of_pose]
    return of_images.times(np.eye(6) - solution.cov @ information)
