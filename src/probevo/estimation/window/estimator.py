"""A step of the sliding window: which measurements connect the new frame with the others, and what
leaves the window.

Its features do, or the dead-reckoned motion, an IMU and other sensors where the images show
nothing, or both where they show a part of the motion. ``window.adjustment`` then adjusts all
frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.config import OdometryConfig
from probevo.estimation.determined import is_determined
from probevo.estimation.far_features import (
    MIN_SIGNAL,
    rotation_of_far_features,
    translation_signal,
)
from probevo.estimation.motion_correction import CovarianceIntersection
from probevo.estimation.motion_estimate import MAX_UNKNOWN, Status
from probevo.estimation.reprojection import ReprojectionSolution
from probevo.estimation.self_calibration import CalibratedMotion
from probevo.estimation.window import inertial_steps
from probevo.estimation.window.adjustment import WindowAdjustment
from probevo.estimation.window.further_measurements import (
    reweighted_and_combined,
    with_dead_reckoning,
    with_measurements,
)
from probevo.estimation.window.marginalization import without_blind
from probevo.estimation.window.new_frame import ReacquiredFeatures, with_new_pose, with_tracks
from probevo.estimation.window.window import Window
from probevo.geometry import se3
from probevo.measurements.base import Measurement
from probevo.measurements.constant_velocity import ConstantVelocity
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.robust_loss import RobustLoss
from probevo.measurements.stereo_observations import StereoObservations
from probevo.measurements.variables import pose_of
from probevo.noise.base import StereoNoise
from probevo.tracking.tracks import Tracks


@dataclass(frozen=True)
class SolvedTracks:
    """The solve of tracks from a frame of the window to a new one."""

    prev: int
    """Index of the frame where they start."""
    calibrated: CalibratedMotion
    span_factor: float = 1.0
    """Factor of the variance of tracks that span several frames."""


class WindowEstimator:
    """Estimates the poses of the last frames together.

    Args:
        camera: the rectified camera.
        config: settings of window, loss and self-calibration.
    """

    def __init__(self, camera: StereoCamera, config: OdometryConfig) -> None:
        self._camera = camera
        self._config = config.window
        self._solver = config.solver
        self._loss = RobustLoss.named(config.solver.loss)
        self.adjustment = WindowAdjustment(camera, config)

    def step(
        self,
        window: Window,
        step: SolvedTracks,
        motion: RelativePose,
        *,
        velocity: ConstantVelocity | None = None,
        intersection: CovarianceIntersection | None = None,
        measurements: Sequence[Measurement] = (),
        reacquired: SolvedTracks | None = None,
    ) -> Window:
        """Return the window after a step, starting from the motion that two frames have shown.

        Without a solve, the dead-reckoned motion counts as a measurement, unless there is an IMU
        that knows it better. A corrected one counts beside the features, with which it shares the
        information of the images.

        Args:
            window: K frames.
            step: the tracks from one of them to the new one.
            motion: the motion between these two frames, corrected if there is a correction; a
                dead-reckoned one may start at an earlier frame.
            velocity: constant velocity over the last two steps; it counts where the features leave
                a direction of the motion open.
            intersection: how features and their corrected motion share the information of their
                images; None without a correction.
            measurements: further measurements of the poses of the window.
            reacquired: tracks from the last frame before dead reckoning, which see it again; None
                if there are none.
        """
        calibrated = step.calibrated
        visual = calibrated.visual
        if calibrated.jitter_cov is not None:
            window = replace(window, jitter_cov=calibrated.jitter_cov)
        features = self._features_of(step)
        if visual.status is not Status.OK or features is None:
            return self._add_unsolved_frame(
                window,
                step,
                motion,
                velocity=velocity,
                intersection=intersection,
                measurements=measurements,
            )
        tracks, noise = features
        if intersection is not None:
            noise = noise.scaled(intersection.feature_factors(visual.weights[visual.used]))
        after = self.add_observed_frame(
            inertial_steps.gate_prediction(window, motion),
            tracks,
            noise,
            motion=motion,
            measurements=measurements,
            motion_factor=None if intersection is None else intersection.motion,
            reacquired=reacquired,
        )
        # If the adjustment has failed, the motion of two frames counts, whose covariance has the
        # errors of the calibration in it.
        has_failed = bool(after.is_blind[-1])
        if has_failed or calibrated.corrected_tracks.rig is None or calibrated.rig is None:
            return after
        # The motion was solved from tracks that were corrected by the estimate before the step.
        effect = after.calibration_effect.with_step(
            calibrated.common_mode,
            used=calibrated.corrected_tracks.rig.image,
            errors=calibrated.rig.image,
            velocity_cov=calibrated.velocity_cov,
        )
        return replace(after, calibration_effect=effect)

    def _add_unsolved_frame(
        self,
        window: Window,
        step: SolvedTracks,
        motion: RelativePose,
        *,
        velocity: ConstantVelocity | None,
        intersection: CovarianceIntersection | None,
        measurements: Sequence[Measurement],
    ) -> Window:
        """Return the window after a step without an accepted solve; see ``step``."""
        frame = motion.curr.frame
        # Features may show a part of the motion, and the velocity before the rest; at the start,
        # the prior of the motion model stands in for that.
        known = velocity or motion
        pair_solution = step.calibrated.visual.two_frames_only
        is_partly_determined = step.calibrated.visual.is_partly_determined
        may_count = intersection is None and is_partly_determined
        if may_count and pair_solution is not None and known.prev_frame == step.prev:
            weak = self._add_weakly_observed_frame(
                window, step, pair_solution, known=known, measurements=measurements
            )
            if isinstance(weak, Window):
                return weak
            if weak is not None:
                measurements = [*measurements, weak]
        if velocity is None or intersection is not None:
            return self.add_unobserved_frame(window, frame, motion, measurements)
        _, last_cov = window.relative(
            window.slot(velocity.prev.frame), window.slot(velocity.before.frame)
        )
        if not _has_seen_since(window, motion) or not np.isfinite(last_cov).all():
            return self.add_unobserved_frame(window, frame, motion, measurements)
        # Since the frame where the dead reckoning starts, such features have shown more of the
        # velocity.
        velocity_motion = velocity.from_prev(window.values(), last_cov)
        return self.add_unobserved_frame(
            window, frame, velocity_motion, measurements, velocity=velocity
        )

    def _features_of(self, step: SolvedTracks) -> tuple[Tracks, StereoNoise] | None:
        """Return the tracks of a solve as the window takes them, and their noise; None without a
        solve that may be trusted."""
        calibrated = step.calibrated
        visual = calibrated.visual
        if not (visual.status is Status.OK or visual.is_partly_determined) or visual.noise is None:
            return None
        noise = visual.noise
        if step.span_factor != 1.0:
            noise = noise.scaled(step.span_factor)
        # The window estimates b of the rig itself, but neither delay, rows nor distortion field.
        rig = calibrated.corrected_tracks.rig
        tracks = calibrated.corrected_tracks.simultaneous.subset(visual.used)
        if rig is not None:
            tracks = tracks.corrected_for_window(rig, self._camera)
        return tracks, noise

    def add_observed_frame(
        self,
        window: Window,
        tracks: Tracks,
        noise: StereoNoise,
        *,
        motion: RelativePose,
        measurements: Sequence[Measurement] = (),
        motion_factor: float | None = None,
        reacquired: SolvedTracks | None = None,
    ) -> Window:
        """Return the window with one more frame and adjusted, no longer than the settings say.

        Where the adjustment fails, or does not fix the newest motion, the motion that two frames
        have shown stands for the features of the frame.

        Args:
            window: K frames.
            tracks: N tracks between a frame of the window and the new one; corrected by the rig's
                calibration, but not for b.
            noise: of these N tracks.
            motion: between these two frames, as two frames have shown it.
            measurements: further measurements of the poses of the window. Those of this motion have
                entered the solve of two frames.
            motion_factor: factor of the covariance with which ``motion`` counts beside the
                features; None if it does not.
            reacquired: tracks from an earlier frame to the new one, which count beside these.
        """
        prev = window.slot(motion.prev_frame)
        frame = motion.curr.frame
        try:
            extended = self.extend(
                window,
                frame,
                motion.T_curr_prev,
                tracks,
                noise,
                prev=prev,
                reacquired=reacquired,
            )
            counted = list(measurements)
            if motion_factor is not None:
                counted.append(motion.scaled(motion_factor))
            adjusted = self.adjustment.adjusted(with_measurements(extended, counted))
            if self._fixes_newest(adjusted, prev):
                return self._shortened(self._with_inertial_start(adjusted))
        except np.linalg.LinAlgError:
            pass  # what no feature fixes makes the normal equations singular; so may be a scale
        # The solve of two frames has had the measurements of its motion. A corrected motion counts
        # even where the IMU knows it better.
        variables = set(motion.variables)
        motion_measurements = [
            measurement for measurement in measurements if set(measurement.variables) == variables
        ]
        others = [
            measurement for measurement in measurements if set(measurement.variables) != variables
        ]
        if motion_factor is not None:
            others.append(motion)
        return self.add_unobserved_frame(
            window,
            frame,
            motion,
            others,
            motion_measurements=motion_measurements,
            motion_is_measured=motion_factor is not None,
        )

    def _add_weakly_observed_frame(
        self,
        window: Window,
        step: SolvedTracks,
        pair_solution: ReprojectionSolution,
        *,
        known: ConstantVelocity | RelativePose,
        measurements: Sequence[Measurement],
    ) -> Window | RelativePose | None:
        """Return the window with one more frame, whose features leave a direction of its motion
        open, as far ones do; there, the velocity of the step before counts, or a motion by dead
        reckoning.

        Args:
            window: K frames.
            step: the tracks from the frame before the new one.
            pair_solution: the motion that these tracks show by themselves.
            known: constant velocity over the last two steps, or a motion between the same frames as
                the tracks.
            measurements: further measurements of the poses of the window.

        Returns:
            Their rotation by two frames instead of the window, where they are so far away that the
            window would take noise of their disparities for a motion; None where all that does not
            fix the motion either.
        """
        features = self._features_of(step)
        if features is None:
            return None
        tracks, noise = features
        # Start at the optimum of both: the tracks alone may be anywhere in the open direction, the
        # other alone so far off in all others that they look like outliers.
        expected = known.expected(window.values())
        difference = se3.log(pair_solution.T_curr_prev @ se3.inverse(expected))
        both = pair_solution.hessian + np.linalg.inv(known.covariance)
        shift = np.linalg.solve(both, pair_solution.hessian @ difference).astype(np.float64)
        T_curr_prev = se3.exp(shift) @ expected
        prev = window.slot(step.prev)
        frame = known.curr.frame
        try:
            extended = self.extend(window, frame, T_curr_prev, tracks, noise, prev=prev)
            measured = with_measurements(extended, measurements)
            if not extended.inertial.bridges_newest:
                measured = with_dead_reckoning(measured, [known])
            adjusted = self.adjustment.adjusted(measured)
        except np.linalg.LinAlgError:
            return None
        _, cov = adjusted.relative(len(adjusted) - 1, prev)
        if not np.isfinite(cov).all():
            return None
        disparity, variance = self.adjustment.disparities(adjusted, tracks.ids)
        known_cov = known.covariance[:3, :3]
        try:
            if (
                translation_signal(pair_solution, disparity, variance, known=known_cov)
                >= MIN_SIGNAL
            ):
                return self._shortened(adjusted)
            return rotation_of_far_features(
                StereoObservations.of(
                    tracks.prev_px, tracks.curr_px, noise, camera=self._camera, loss=self._loss
                ),
                known,
                pair_solution.T_curr_prev[:3, :3],
                expected=expected,
                prev=pose_of(step.prev),
            )
        except np.linalg.LinAlgError:
            return None

    def add_unobserved_frame(
        self,
        window: Window,
        frame: int,
        motion: RelativePose,
        measurements: Sequence[Measurement] = (),
        *,
        motion_measurements: Sequence[Measurement] = (),
        velocity: ConstantVelocity | None = None,
        motion_is_measured: bool = False,
    ) -> Window:
        """Return the window with one more frame, which no feature connects with the others.

        Either the motion counts, or what the IMU has measured meanwhile, whichever is known better.

        Args:
            window: K frames.
            frame: index of the new one.
            motion: measured between one of them and the new one, as by dead reckoning.
            measurements: further measurements of the poses of the window.
            motion_measurements: measurements that the motion is estimated from, so that they count
                only where it does not.
            velocity: what the motion is estimated from; it counts in place of the motion.
            motion_is_measured: whether the motion is one of these measurements, as a corrected one;
                it must not count twice.
        """
        given = measurements
        none = StereoNoise(scale=np.zeros((0, 4, 4)), dof=np.zeros(0), bias=np.zeros((0, 4)))
        window = inertial_steps.drop_weaker_factor(window, motion)
        # The motion by dead reckoning or IMU alone, before the sensors.
        reckoned = _bounded(inertial_steps.predicted_motion(window, frame) or motion)
        measurements, guess = reweighted_and_combined(reckoned, measurements, window)
        prev = window.slot(reckoned.prev_frame)
        extended = self.extend(window, frame, guess, Tracks.none(), none, prev=prev)
        if not motion_is_measured:
            if extended.inertial.bridges_newest:
                measurements = [*measurements, *motion_measurements]
            else:
                measurements = [*measurements, velocity or _bounded(motion)]
        measured = with_dead_reckoning(extended, measurements)
        try:
            adjusted = self.adjustment.adjusted(measured)
            if np.isfinite(adjusted.cov).all() or not window.inertial.is_used:
                return self._shortened(adjusted)
        except np.linalg.LinAlgError:
            if not window.inertial.is_used:
                return self._restarted(window, extended, _bounded(motion))
        # It may be the IMU's own states that nothing fixes: once more without them.
        left_out = inertial_steps.without_imu(window, inertial_steps.NO_SOLUTION)
        return self.add_unobserved_frame(
            left_out,
            frame,
            motion,
            given,
            motion_measurements=motion_measurements,
            velocity=velocity,
            motion_is_measured=motion_is_measured,
        )

    def _restarted(self, window: Window, extended: Window, motion: RelativePose) -> Window:
        """Return a new window of the last frame and the next one, where the old one has no
        solution: nothing but the last pose and its covariance is kept.

        Args:
            window: K frames.
            extended: the same with the next one.
            motion: to the next frame, from one of them.
        """
        last = pose_of(int(window.frames[-1]))
        T_curr_last = extended.T_cam_world[-1] @ se3.inverse(extended.T_cam_world[-2])
        step = RelativePose(T_curr_last, motion.covariance, curr=motion.curr, prev=last)
        begun = with_new_pose(window.restarted(), motion.curr.frame, T_curr_last, prev=0)
        adjusted = self.adjustment.adjusted(with_dead_reckoning(begun, [step]))
        return inertial_steps.with_reason_to_wait(adjusted, self._most_frames)

    def _with_inertial_start(self, window: Window) -> Window:
        """Return the window with velocities, biases and gravity, once its IMU has shown them."""
        started = inertial_steps.initialize_states(window, self._most_frames)
        if not started.inertial.is_used or window.inertial.is_used:
            return started
        try:
            return self.adjustment.adjusted(started)
        except np.linalg.LinAlgError:
            return inertial_steps.without_imu(window, inertial_steps.NO_SOLUTION)

    @property
    def _most_frames(self) -> int:
        """Most frames of a window before the oldest leaves it, blind ones not counted."""
        return self._config.frames + 1

    def _fixes_newest(self, window: Window, prev: int) -> bool:
        """Return whether the motion from a frame to the newest is known as well as one of two
        frames has to be."""
        # The motion, not the pose: the covariance of a pose in the world grows along the path.
        _, cov = window.relative(len(window) - 1, prev)
        return is_determined(cov, self._solver)

    def _shortened(self, window: Window) -> Window:
        """Return the window with no more frames than the settings say.

        Blind frames come on top, as many as other ones at most, until a later frame has features:
        what was seen before may then be found again, and their dead reckoning is measured from
        there. With an IMU that is used, they are frames like others.
        """
        window = replace(window, marginalized=())
        window = inertial_steps.exclude_if_untestable(window, self._most_frames)
        window = inertial_steps.with_reason_to_wait(window, self._most_frames)
        limit = self._config.frames
        if not window.inertial.is_used:
            leaving = window.is_blind.copy()
            leaving[-2:] = False  # the last step leads from one to the other
            if window.is_blind[-1]:
                leaving &= np.cumsum(leaving) <= window.is_blind.sum() - limit
            window = without_blind(window, leaving)
            limit += int(window.is_blind.sum())
        while len(window) > limit:  # one, or more once a blind frame has features after all
            window = self.adjustment.without_oldest(window)
        return window

    def extend(
        self,
        window: Window,
        frame: int,
        T_curr_prev: FloatArray,
        tracks: Tracks,
        noise: StereoNoise,
        *,
        prev: int = -1,
        reacquired: SolvedTracks | None = None,
    ) -> Window:
        """Return the window with one more frame, which is not yet adjusted.

        Args:
            window: K frames.
            frame: index of the new one.
            T_curr_prev: a guess of the motion from the previous frame, [4, 4].
            tracks: N tracks between these two frames, corrected by the rig's calibration but for
                b₁ and b₂.
            noise: of these N tracks.
            prev: slot of the previous frame, which is the last one unless those after it are
                blind.
            reacquired: tracks from an earlier frame, if there are any that see it again.
        """
        prev %= len(window)
        extended = with_new_pose(window, frame, T_curr_prev, prev=prev)
        features = None if reacquired is None else self._features_of(reacquired)
        if reacquired is None or features is None:
            return with_tracks(
                extended, tracks, noise, prev=prev, camera=self._camera, loss=self._loss
            )
        # A feature of both counts once, by its landmark in the earlier frame.
        reacquired_tracks, reacquired_noise = features
        earlier = ReacquiredFeatures(window.slot(reacquired.prev), reacquired_tracks.ids)
        extended = with_tracks(
            extended,
            tracks,
            noise,
            prev=prev,
            reacquired=earlier,
            camera=self._camera,
            loss=self._loss,
        )
        others = np.flatnonzero(~np.isin(reacquired_tracks.ids, tracks.ids))
        return with_tracks(
            extended,
            reacquired_tracks.subset(others),
            reacquired_noise.subset(others),
            prev=earlier.slot,
            camera=self._camera,
            loss=self._loss,
        )


def _has_seen_since(window: Window, motion: RelativePose) -> bool:
    """Return whether features connect a frame after the one where a motion starts."""
    start = window.slot(motion.prev_frame)
    return not bool(window.is_blind[start + 1 :].all())


def _bounded(motion: RelativePose) -> RelativePose:
    """Return a measured motion that is as if known to ``MAX_UNKNOWN``, where it is known less."""
    # Scaling rows and columns alike keeps the correlations.
    sigma = np.sqrt(np.diagonal(motion.covariance))
    if (sigma <= MAX_UNKNOWN).all():
        return motion
    factor = np.minimum(1.0, MAX_UNKNOWN / sigma)
    cov = factor[:, None] * motion.covariance * factor
    return RelativePose(motion.T_curr_prev, cov, motion.curr, motion.prev)
