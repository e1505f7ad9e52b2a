"""Self-calibration: the motion of a step and the rig's calibration, each of which depends on the
other.

Tracks are corrected by the calibration, and the residuals of the solve reveal its remaining errors
(``estimation.rig_update``). On some rigs, two of these errors are so large that the step is solved
again once they are known:

- Jitter. If the tracks show more jitter than expected, they are solved again with the larger
  covariance, as in the first frames of a rig that flexes more than the prior.
- Times. If the right camera is exposed at another time than the left one, or rows at other times
  than the middle one, the correction depends on the motion: the tracks are corrected with the
  solved motion, and solved again. Where rows show how the velocity changes in the step
  (``estimation.velocity_change``), they are corrected by that.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.exposure_delay import is_noticeable
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.rolling_shutter import Twists, change_sensitivity
from probevo.camera.stereo import StereoCamera
from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.estimation.motion_model import MotionModel, MotionPrediction
from probevo.estimation.reprojection import ReprojectionSolution
from probevo.estimation.rig_update import CommonMode, update_rig
from probevo.estimation.velocity_change import ChangeUnknown, estimate_change
from probevo.estimation.visual_estimator import VisualEstimator
from probevo.estimation.visual_motion import MotionPriors, VisualMotion
from probevo.geometry import se3
from probevo.stage_clock import StageClock
from probevo.tracking.corrected_tracks import CorrectedTracks

MAX_REPEATED_SOLVES = 3
"""Largest number of repeated solves because of more jitter than expected."""
CHANGE_ITERATIONS = 2
"""Gauss–Newton iterations of the change of the velocity, with a solve of the motion each."""


@dataclass(frozen=True)
class CalibratedMotion:
    """The motion of a step by its tracks, and the calibration of the rig after it."""

    corrected_tracks: CorrectedTracks
    """The tracks as they were solved."""
    visual: VisualMotion
    rig: RigCalibration | None
    """The calibration after the step; None without self-calibration."""
    image_common_mode: CommonMode
    """How errors of the calibration before the step move its motion by the images alone."""
    common_mode: CommonMode
    """The same of the solved motion, to which other measurements contribute, too."""
    jitter_cov: FloatArray | None
    """Covariance of the rig's jitter that the solve assumed, [3, 3], rad²; None without any."""
    velocity_cov: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))
    """What the velocity within the step, as far as it is unknown, adds to the covariance of the
    motion, [6, 6]; zero for a global shutter."""

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
            cov=solution.cov + common_mode @ common_mode.T + self.velocity_cov,
            status=visual.status,
            num_tracks=len(self.corrected_tracks.tracks),
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
        reckoned = model.dead_reckoned(prediction, visual.solution, is_rejected=visual.is_rejected)
        return MotionEstimate(
            T_curr_prev=reckoned.T_curr_prev,
            cov=reckoned.cov,
            status=Status.GAP if model.is_gap(duration_s) else visual.status,
            num_tracks=len(self.corrected_tracks.tracks),
            num_inliers=visual.num_inliers,
            iterations=visual.num_iterations,
            path_cross_cov=reckoned.path_cross_cov,
            num_used=visual.num_used,
            num_out_of_domain=visual.num_out_of_domain,
        )


@dataclass(frozen=True)
class _StepVelocity:
    """The velocity at the two frames of a step, by its mean between them and by its change."""

    duration_s: float
    last_twist: FloatArray | None
    """Twist per second of the previous step, [6]; None if it is not known, and that of this step
    stands for both frames."""
    change_cov: FloatArray
    """Covariance of the change of the twist in the step, given that from the last one, [6, 6]."""
    estimated: FloatArray | None = None
    """Its change from one frame to the other, [6], if that has been estimated."""

    def twists(self, solution: ReprojectionSolution) -> Twists:
        """Return the velocities at the two frames, for the motion of the step."""
        mean = self._mean(solution)
        change = self._change(solution)
        return Twists(
            prev=mean - 0.5 * change,
            curr=mean + 0.5 * change,
            duration_s=self.duration_s,
            are_estimated=self.estimated is not None,
        )

    def unknown(
        self, solution: ReprojectionSolution, readout_s: float, camera: StereoCamera
    ) -> ChangeUnknown | None:
        """Return the change as an unknown of the step; None where the features do not show it.

        Args:
            solution: the motion from the two frames alone.
            readout_s: the readout time by which its tracks were corrected.
            camera: the rectified camera.
        """
        if self.last_twist is None or not readout_s or not solution.is_determined:
            return None
        return ChangeUnknown(
            value=self._change(solution),
            sensitivity=change_sensitivity(
                solution.T_curr_prev,
                readout_s,
                self.duration_s,
                camera,
                refined=solution.features.refined,
            ),
            prior_mean=self._mean(solution) - self.last_twist,
            prior_cov=self.change_cov,
        )

    def _change(self, solution: ReprojectionSolution) -> FloatArray:
        """Return the change, [6]: unless it has been estimated, that from the last step's mean to
        that of this one."""
        if self.estimated is not None:
            return self.estimated
        if self.last_twist is None:
            return np.zeros(6)
        return self._mean(solution) - self.last_twist

    def _mean(self, solution: ReprojectionSolution) -> FloatArray:
        return se3.log(solution.T_curr_prev) / self.duration_s


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
        motion_model: MotionModel,
        duration_s: float,
        seed: Sequence[int],
        clock: StageClock,
    ) -> CalibratedMotion:
        """Estimate the motion of N tracks, and update the rig's calibration.

        Args:
            corrected: the N tracks.
            phi: the predictors of these tracks, [N, M].
            priors: what is known about the step before its tracks are used.
            motion_model: with the velocity of the previous step.
            duration_s: time between the two frames.
            seed: of RANSAC's samples; every repeated solve draws the same ones.
            clock: takes the times of the stages ``consensus`` and ``solve``.
        """
        velocity = _StepVelocity(
            duration_s,
            last_twist=motion_model.twist if corrected.knows_velocity else None,
            change_cov=motion_model.twist_change_cov(duration_s),
        )

        def solve(tracks: CorrectedTracks, assumed: _StepVelocity) -> CalibratedMotion:
            """Solve for the motion of these tracks under this velocity."""
            return self._solve_until_jitter_fits(
                tracks, phi, priors, assumed, seed=seed, clock=clock
            )

        found = solve(corrected, velocity)
        first = found.visual.solution
        if first is not None and _depends_on_velocity(corrected.rig):
            # It has been solved under the velocity of the last step, and need not have converged.
            twists = velocity.twists(first)
            found = solve(corrected.at_twists(twists, self._camera), velocity)
            found = self._with_change(found, velocity, solve)
        if found.visual.status is not Status.OK:
            # Keep the row offsets, which need no motion, and discard all else: the motion that it
            # depends on was rejected.
            return replace(found, rig=found.corrected_tracks.rig)
        return replace(found, rig=self._rig_with_delay(found, duration_s))

    def _with_change(
        self,
        found: CalibratedMotion,
        velocity: _StepVelocity,
        solve: Callable[[CorrectedTracks, _StepVelocity], CalibratedMotion],
    ) -> CalibratedMotion:
        """Return the motion of a step with the change of the velocity that a rolling shutter shows.

        Args:
            found: the motion for the change from the last step to this one.
            velocity: that change.
            solve: solves for the motion of tracks under a velocity.
        """
        for _ in range(CHANGE_ITERATIONS):
            solution = found.visual.two_frames_only
            if found.visual.solution is None or solution is None:
                break
            unknown = velocity.unknown(solution, found.corrected_tracks.readout_s, self._camera)
            if unknown is None:
                break
            change = estimate_change(unknown, solution)
            velocity = replace(velocity, estimated=change.mean)
            twists = velocity.twists(solution)
            again = solve(found.corrected_tracks.at_twists(twists, self._camera), velocity)
            if again.visual.status is not Status.OK and found.visual.status is Status.OK:
                break
            found = replace(again, velocity_cov=change.motion_cov)
        return found

    def _solve_until_jitter_fits(
        self,
        corrected: CorrectedTracks,
        phi: FloatArray,
        priors: MotionPriors,
        velocity: _StepVelocity,
        *,
        seed: Sequence[int],
        clock: StageClock,
    ) -> CalibratedMotion:
        """Solve, repeatedly if the tracks show more jitter than assumed; the delay is not
        updated."""
        rig = corrected.rig
        jitter_cov = None if rig is None else rig.jitter.cov
        for attempt in range(1 + MAX_REPEATED_SOLVES):
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
                    image_common_mode=CommonMode.none(),
                    common_mode=CommonMode.none(),
                    jitter_cov=learned if rig is None else jitter_cov,
                )
            # What the solve shows of the rig; solve again if that is more jitter than the solve
            # assumed.
            used = corrected.tracks.subset(visual.used)
            two_frames = visual.two_frames_only
            updated, image_common_mode = update_rig(
                rig,
                used,
                two_frames,
                self._camera,
                velocity.twists(two_frames),
                change=velocity.unknown(two_frames, corrected.readout_s, self._camera),
            )
            if attempt == MAX_REPEATED_SOLVES or not updated.jitter.exceeds(jitter_cov):
                break
            jitter_cov = updated.jitter.cov
        return CalibratedMotion(
            corrected,
            visual,
            rig=updated,
            image_common_mode=image_common_mode,
            common_mode=_beside_measurements(priors, visual.solution, image_common_mode),
            jitter_cov=jitter_cov,
        )

    def _rig_with_delay(self, found: CalibratedMotion, duration_s: float) -> RigCalibration | None:
        """Return the calibration after an accepted solve, with the exposure delay updated."""
        visual = found.visual
        if found.rig is None or visual.two_frames_only is None:
            return found.rig
        rig = found.rig.with_delay(
            found.corrected_tracks.raw.curr_px[visual.used],
            se3.log(visual.accepted_solution.T_curr_prev) / duration_s,
            self._camera,
        )
        prior = found.corrected_tracks.prior_rig
        if prior is not None and rig.delay.differs_from(found.corrected_tracks.delay_s):
            # The tracks were corrected with a delay that turned out to be wrong. Keep nothing but
            # the new delay.
            return replace(prior, delay=rig.delay)
        return rig


def _depends_on_velocity(rig: RigCalibration | None) -> bool:
    """Return whether the correction of the tracks depends on the velocity of the camera."""
    if rig is None:
        return False
    return is_noticeable(rig.delay.delay_s) or rig.image.readout_s != 0.0


def _beside_measurements(
    priors: MotionPriors, solution: ReprojectionSolution | None, image_common_mode: CommonMode
) -> CommonMode:
    """Return how errors of the calibration move a motion beside other measurements of it.

    With H U₀ = C of the images alone and P⁻¹ = H + Σ Jᵀ R⁻¹ J of the solve, U = P C is
    (1 − P Σ Jᵀ R⁻¹ J) U₀.

    Args:
        priors: with these measurements.
        solution: the solve; None if it is degenerate.
        image_common_mode: U₀.
    """
    if solution is None or not priors.measurements:
        return image_common_mode
    information = priors.information_of_measurements(solution.T_curr_prev)
    return image_common_mode.times(np.eye(6) - solution.cov @ information)
