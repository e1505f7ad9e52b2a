"""Bundle adjustment of a sliding window, and marginalisation of what leaves it.

Given observations y, the window estimates poses and landmarks x and the errors b of the rig, of its
disparities and lenses. It maximises

    log p(x | b, y) + (1/c) log p(y | b) + log p(b).

The errors of neighbouring features are correlated, and consecutive frames repeat them, hence the
tempering of the likelihood of b by 1/c (``CORRELATED_FEATURES``). The information of p(y | b) is
the Schur complement of x in the normal equations. Each solve divides it by c. The marginal prior
stores it undivided, so that nothing is tempered twice.

The jitter of the rig in each frame, ω_k ~ N(0, S), is eliminated from the normal equations once all
landmarks are. When landmarks leave the window, they take what they say of it along, so that the
prior and the landmarks that remain each have a jitter of their own for one and the same frame. If
G groups of landmarks say the same with variances G S, together they say it with S: those that leave
do so with G S.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray, rows_of
from probevo.camera.image_errors import DISPARITY_SIGMA_PX
from probevo.camera.rig_calibration import (
    CONSTANT_SIGMA_PX,
    CORRELATED_FEATURES,
    disparity_basis,
)
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer_numba import Intrinsics
from probevo.config import OdometryConfig
from probevo.estimation.motion_correction import Shares
from probevo.estimation.motion_estimate import Status
from probevo.estimation.reprojection import ReprojectionSolution
from probevo.estimation.self_calibration import CalibratedMotion
from probevo.estimation.window import inertial_steps
from probevo.estimation.window.equations import (
    FRAME,
    JITTER,
    LANDMARK,
    LENS,
    POSE,
    RIG,
    Elimination,
    RobustNoise,
    WindowEquations,
    WindowGeometry,
    WindowLandmarks,
    WindowObservations,
)
from probevo.estimation.window.further_measurements import tested_against, with_measurements
from probevo.estimation.window.inertial import Inertial
from probevo.estimation.window.inertial_equations import InertialSystem
from probevo.estimation.window.jitter_elimination import (
    JitterElimination,
    eliminate_jitter,
    jitter_columns,
)
from probevo.estimation.window.marginalization import (
    kept_positive,
    pose_covariance,
    with_pose,
    without_blind,
    without_poses,
)
from probevo.estimation.window.normal_equations_numba import (
    accumulate,
    fill_roots,
    move_landmarks,
    static_weights,
)
from probevo.estimation.window.window import MarginalPrior, Window, merged, selected
from probevo.geometry import se3
from probevo.measurements.base import Measurement, pose_of
from probevo.measurements.constant_velocity import ConstantVelocity
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.robust_loss import RobustLoss
from probevo.noise.base import StereoNoise
from probevo.tracking.tracks import Tracks

LENS_SIGMA = 0.02
"""Prior standard deviation of k₁: what is seen 45° from the axis moves by 2 % of the focal
length."""
RIG_SIGMA = np.array([CONSTANT_SIGMA_PX, *DISPARITY_SIGMA_PX, LENS_SIGMA])
"""Prior standard deviation of b₀, b₁ and b₂, px, and k₁."""
FLAWLESS = 1e-6
"""Factor of these standard deviations without self-calibration: a rig that is taken as calibrated
has the same states, which the prior holds at zero."""
CONVERGED_BELOW = 0.1
"""A step after which further ones would lower the cost by less than this, in nats, is the last."""
MIN_DAMPING = 1e-4
"""Share of its diagonal that is first added to the Hessian, after a step that raised the cost."""
COST_TOLERANCE = 1.0
"""Nats by which a step may raise the cost."""
MAX_UNKNOWN = np.repeat([1e3, 2.0], 3)
"""Largest standard deviation of a measured motion, m and rad: a kilometre, and that of an angle of
which nothing is known (π/√3). Beside features that know the motions between other frames to 0.1 mm,
rounding would lose what is less certain."""
MIN_VARIANCE_PX2 = 1e-12
"""Variance of a time-correlated disparity error in a noise model that knows none."""


@dataclass(frozen=True)
class SolvedTracks:
    """The solve of tracks from a frame of the window to a new one."""

    prev: int
    """Index of the frame where they start."""
    solved: CalibratedMotion
    noise_factor: float = 1.0
    """Factor of the variance of tracks that span several frames."""


@dataclass(frozen=True)
class _System:
    """The normal equations of a window at its current values."""

    window: Window
    cost: float
    equations: WindowEquations
    elimination: Elimination
    jitter: JitterElimination
    inertial: InertialSystem | None


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
        self._noise = RobustNoise(loss=int(self._loss.kind), correlation=config.window.correlation)
        rig_sigma = RIG_SIGMA if config.self_calibration else FLAWLESS * RIG_SIGMA
        self._rig_information = np.diag(rig_sigma**-2.0)
        self._intrinsics = Intrinsics.of(camera)

    def with_step(
        self,
        window: Window,
        step: SolvedTracks,
        motion: RelativePose,
        *,
        velocity: ConstantVelocity | None = None,
        shares: Shares | None = None,
        measurements: Sequence[Measurement] = (),
        found_again: SolvedTracks | None = None,
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
            velocity: that the velocity is that of the step before; it counts where the features
                leave a direction of the motion open.
            shares: how the features and their corrected motion share the information of their
                images; None without a correction.
            measurements: further measurements of the poses of the window.
            found_again: tracks from the last frame before dead reckoning, which see it again; None
                if there are none.
        """
        # Without an accepted solve there is no noise of the features to count them with.
        solved = step.solved
        visual = solved.visual
        frame = motion.curr.frame
        features = self._features_of(step)
        two_frames = visual.two_frames_only
        if visual.is_weak and features and two_frames and velocity and shares is None:
            weak = self._with_weak_features(
                window, *features, two_frames, velocity=velocity, measurements=measurements
            )
            if weak is not None:
                return weak
        if visual.status is not Status.OK or features is None:
            return self.without_features(window, frame, motion, measurements)
        tracks, noise = features
        if shares is not None:
            noise = noise.scaled(shares.of_features(visual.weights[visual.used]))
        if solved.jitter_cov is not None:
            window = replace(window, jitter_cov=solved.jitter_cov)
        after = self.with_features(
            inertial_steps.with_inflated_factor_if_refuted(window, motion),
            tracks,
            noise,
            two_frames=motion,
            measurements=measurements,
            motion_factor=None if shares is None else shares.motion,
            found_again=found_again,
        )
        if solved.corrected.rig is None or solved.rig is None:
            return after
        # The motion was solved from tracks that were corrected by the field before the step.
        distortion = after.distortion.with_step(
            solved.common_mode.distortion_gain,
            solved.common_mode.focal_gain,
            used_px=solved.corrected.rig.image.distortion,
            errors=solved.rig.image,
        )
        return replace(after, distortion=distortion)

    def _features_of(self, step: SolvedTracks) -> tuple[Tracks, StereoNoise] | None:
        """Return the tracks of a solve as the window takes them, and their noise; None without a
        solve that may be trusted."""
        solved = step.solved
        visual = solved.visual
        if not (visual.status is Status.OK or visual.is_weak) or visual.noise is None:
            return None
        noise = visual.noise
        if step.noise_factor != 1.0:
            noise = noise.scaled(np.full(len(noise.scale), step.noise_factor))
        # The window estimates b of the rig itself, but neither delay, rows nor distortion field.
        rig = solved.corrected.rig
        tracks = solved.corrected.simultaneous.subset(visual.used)
        if rig is not None:
            tracks = tracks.corrected_for_window(rig, self._camera)
        return tracks, noise

    def with_features(
        self,
        window: Window,
        tracks: Tracks,
        noise: StereoNoise,
        *,
        two_frames: RelativePose,
        measurements: Sequence[Measurement] = (),
        motion_factor: float | None = None,
        found_again: SolvedTracks | None = None,
    ) -> Window:
        """Return the window with one more frame and adjusted, no longer than the settings say.

        Where the adjustment fails, or does not fix the newest motion, the motion that two frames
        have shown stands for the features of the frame.

        Args:
            window: K frames.
            tracks: N tracks between a frame of the window and the new one; corrected by the rig's
                calibration, but not for b.
            noise: of these N tracks.
            two_frames: the motion between these two frames by itself, with its covariance.
            measurements: further measurements of the poses of the window. Those of this motion have
                entered the solve of two frames.
            motion_factor: factor of the covariance with which ``two_frames`` counts beside the
                features; None if it does not.
            found_again: tracks from an earlier frame to the new one, which count beside these.
        """
        prev = window.slot(two_frames.variables[0].frame)
        frame = two_frames.curr.frame
        try:
            extended = self.with_frame(
                window, frame, two_frames.T_curr_prev, tracks, noise, prev=prev
            )
            if found_again is not None:
                extended = self._with_found_again(extended, found_again, tracks)
            counted = list(measurements)
            if motion_factor is not None:
                counted.append(two_frames.scaled(motion_factor))
            adjusted = self.adjusted(with_measurements(extended, counted))
            if self._fixes_newest(adjusted, prev):
                return self._shortened(self._with_inertial_start(adjusted))
        except np.linalg.LinAlgError:
            pass  # what no feature fixes makes the normal equations singular; so may be a scale
        # The solve of two frames has had the measurements of its motion. A corrected motion counts
        # even where the IMU knows it better.
        variables = set(two_frames.variables)
        of_motion = [one for one in measurements if set(one.variables) == variables]
        others = [one for one in measurements if set(one.variables) != variables]
        if motion_factor is not None:
            others.append(two_frames)
        return self.without_features(window, frame, two_frames, others, in_motion=of_motion)

    def _with_weak_features(
        self,
        window: Window,
        tracks: Tracks,
        noise: StereoNoise,
        two_frames: ReprojectionSolution,
        *,
        velocity: ConstantVelocity,
        measurements: Sequence[Measurement],
    ) -> Window | None:
        """Return the window with one more frame, whose features leave a direction of its motion
        open, as far ones do; there, the velocity of the step before counts.

        Args:
            window: K frames.
            tracks: N tracks from the frame before the new one, as of ``with_features``.
            noise: of these N tracks.
            two_frames: the motion that these tracks show by themselves.
            velocity: that it is the same as in the step before.
            measurements: further measurements of the poses of the window.

        Returns:
            None where all that does not fix the motion either.
        """
        # Start at the optimum of both: the tracks alone may be anywhere in the open direction, the
        # velocity alone so far off in all others that they look like outliers.
        values = dict(zip(map(pose_of, window.frames.tolist()), window.T_cam_world, strict=True))
        expected = velocity.expected(values)
        difference = se3.log(two_frames.T_curr_prev @ se3.inverse(expected))
        both = two_frames.hessian + np.linalg.inv(velocity.covariance)
        step = np.linalg.solve(both, two_frames.hessian @ difference).astype(np.float64)
        T_curr_prev = se3.exp(step) @ expected
        prev = window.slot(velocity.prev.frame)
        frame = velocity.curr.frame
        try:
            extended = self.with_frame(window, frame, T_curr_prev, tracks, noise, prev=prev)
            counted = list(measurements)
            if not extended.inertial.bridges_newest:
                counted.append(velocity)
            adjusted = self.adjusted(with_measurements(extended, counted))
        except np.linalg.LinAlgError:
            return None
        _, cov = adjusted.relative(len(adjusted) - 1, prev)
        return self._shortened(adjusted) if np.isfinite(cov).all() else None

    def without_features(
        self,
        window: Window,
        frame: int,
        motion: RelativePose,
        measurements: Sequence[Measurement] = (),
        *,
        in_motion: Sequence[Measurement] = (),
    ) -> Window:
        """Return the window with one more frame, which no feature connects with the others.

        Either the motion counts, or what the IMU has measured meanwhile, whichever is known better.

        Args:
            window: K frames.
            frame: index of the new one.
            motion: measured between one of them and the new one, as by dead reckoning.
            measurements: further measurements of the poses of the window; it may be one of them.
            in_motion: measurements that the motion is estimated from, so that they count only where
                it does not.
        """
        given = measurements
        none = StereoNoise(scale=np.zeros((0, 4, 4)), dof=np.zeros(0), bias=np.zeros((0, 4)))
        window = inertial_steps.without_factor_if_worse(window, motion)
        # The motion by dead reckoning or IMU alone, before the sensors.
        reckoned = _bounded(inertial_steps.predicted_motion(window, frame) or motion)
        measurements, guess = tested_against(reckoned, measurements, window)
        prev = window.slot(reckoned.variables[0].frame)
        extended = self.with_frame(window, frame, guess, Tracks.none(), none, prev=prev)
        # A corrected motion is one of the measurements already, and must not count twice.
        if all(one is not motion for one in given):
            if extended.inertial.bridges_newest:
                measurements = [*measurements, *in_motion]
            else:
                measurements = [*measurements, _bounded(motion)]
        measured = with_measurements(extended, measurements)
        try:
            adjusted = self.adjusted(measured)
            if np.isfinite(adjusted.cov).all() or not window.inertial.is_used:
                return self._shortened(adjusted)
        except np.linalg.LinAlgError:
            if not window.inertial.is_used:
                raise
        # It may be the IMU's own states that nothing fixes: once more without them.
        left_out = inertial_steps.without_imu(window, inertial_steps.NO_SOLUTION)
        return self.without_features(left_out, frame, motion, given, in_motion=in_motion)

    def _with_inertial_start(self, window: Window) -> Window:
        """Return the window with velocities, biases and gravity, once its IMU has shown them."""
        started = inertial_steps.with_states_if_consistent(window, self._most_frames)
        if not started.inertial.is_used or window.inertial.is_used:
            return started
        try:
            return self.adjusted(started)
        except np.linalg.LinAlgError:
            return inertial_steps.without_imu(window, inertial_steps.NO_SOLUTION)

    @property
    def _most_frames(self) -> int:
        """Most frames of a window before the oldest leaves it, blind ones not counted."""
        return self._config.frames + 1

    def _fixes_newest(self, window: Window, prev: int) -> bool:
        """Return whether the motion from a frame to the newest is known as well as one of two
        frames has to be."""
        # Of the motion: the covariance of a pose in the world grows along the path.
        _, cov = window.relative(len(window) - 1, prev)
        if not np.isfinite(cov).all():
            return False
        # Eigenvalues, not the diagonal: the direction that is not known may lie across the axes.
        translation = np.linalg.eigvalsh(cov[:3, :3])
        rotation = np.linalg.eigvalsh(cov[3:, 3:])
        return bool(
            translation[0] > 0.0
            and rotation[0] > 0.0
            and translation[-1] < self._solver.max_translation_sigma_m**2
            and rotation[-1] < self._solver.max_rotation_sigma_rad**2
        )

    def _shortened(self, window: Window) -> Window:
        """Return the window with no more frames than the settings say.

        Blind frames come on top, as many as other ones at most, until a later frame has features:
        what was seen before may then be found again, and their dead reckoning is measured from
        there. With an IMU that is used, they are frames like others.
        """
        window = replace(window, marginalized=())
        window = inertial_steps.without_imu_if_untestable(window, self._most_frames)
        limit = self._config.frames
        if not window.inertial.is_used:
            leaving = window.is_blind.copy()
            leaving[-2:] = False  # the last step leads from one to the other
            if window.is_blind[-1]:
                leaving &= np.cumsum(leaving) <= window.is_blind.sum() - limit
            window = without_blind(window, leaving)
            limit += int(window.is_blind.sum())
        while len(window) > limit:  # one, or more once a blind frame has features after all
            window = self.without_oldest(window)
        return window

    def with_frame(
        self,
        window: Window,
        frame: int,
        T_curr_prev: FloatArray,
        tracks: Tracks,
        noise: StereoNoise,
        *,
        prev: int = -1,
    ) -> Window:
        """Return the window with one more frame, which is not yet adjusted.

        A track whose landmark the previous frame saw last adds an observation to it; any other
        begins a landmark with both of its observations. Noise that refers to residuals is halved:
        it is that of two observations.

        Args:
            window: K frames.
            frame: index of the new one.
            T_curr_prev: a guess of the motion from the previous frame, [4, 4].
            tracks: N tracks between these two frames, corrected by the rig's calibration but for
                b₁ and b₂.
            noise: of these N tracks.
            prev: slot of the previous frame, which is the last one unless those after it are
                blind.
        """
        prev %= len(window)
        # T_curr_world = T_curr_prev T_prev_world. The prior gets rows and columns of zeros for it,
        # so that the pose may still be linearised anew (``_incremented``).
        T_new = T_curr_prev @ window.T_cam_world[prev]
        extended = replace(
            window,
            inertial=window.inertial.with_new_frame(),
            frames=np.append(window.frames, frame),
            T_cam_world=np.concatenate([window.T_cam_world, T_new[None]]),
            T_linear=np.concatenate([window.T_linear, T_new[None]]),
            is_blind=np.append(window.is_blind, True),
            distortion=window.distortion.carried_to_new(prev, T_curr_prev),
            jitter=np.concatenate([window.jitter, np.zeros((1, JITTER))]),
            prior=with_pose(window.prior),
        )
        return self._with_tracks(extended, tracks, noise, prev=prev)

    def _with_tracks(
        self, window: Window, tracks: Tracks, noise: StereoNoise, *, prev: int
    ) -> Window:
        """Return the window with observations of its newest frame; see ``with_frame``.

        Args:
            window: K frames.
            tracks: N tracks from one of them to the newest.
            noise: of these N tracks.
            prev: slot of the frame where they start.
        """
        if not len(tracks):
            return window
        newest = len(window) - 1
        # The landmark of each track; new ones are numbered behind those of the window.
        rows = _rows_of(window, tracks.ids, prev)
        is_new = rows < 0
        rows[is_new] = len(window.ids) + np.arange(int(is_new.sum()))
        if noise.refers_to == "residual":
            noise = noise.scaled(np.full(len(tracks), 0.5))
        prev_scale = noise.scale if noise.prev_scale is None else noise.prev_scale
        parameters = self._loss.parameters(noise.dof)
        # Observations: all in the new frame, and those of new landmarks in the frame before, too,
        # which is their anchor.
        first_px = tracks.prev_px[is_new]
        # Each observation counts with the noise at its own time.
        scale = np.concatenate([prev_scale[is_new], noise.scale])
        # A bias is the mean of a step's residual: an observation has those of all steps since the
        # first of its track in its error.
        bias = np.concatenate([window.landmarks.bias, np.zeros_like(first_px)])
        bias[rows] += noise.bias
        root = np.zeros_like(scale)
        if not fill_roots(scale, root):
            raise np.linalg.LinAlgError("the scale of an observation is not positive definite")
        new = WindowObservations(
            start=np.zeros(0, np.int64),
            slot=np.concatenate([np.full(len(first_px), prev), np.full(len(tracks), newest)]),
            pixels=np.concatenate([first_px, tracks.curr_px - bias[rows]]),
            root=root,
            loss_parameter=np.concatenate([parameters[is_new], parameters]),
        )
        # Landmarks: the new ones as their first observation shows them, with the prior of δ, whose
        # information is 1/τ².
        variance = np.zeros(len(tracks))
        if noise.time_correlated is not None:
            variance = noise.time_correlated
        landmarks = WindowLandmarks(
            state=np.concatenate(
                [window.landmarks.state, self._first_states(first_px, window.rig)]
            ),
            error_information=np.concatenate(
                [
                    window.landmarks.error_information,
                    1.0 / np.maximum(variance[is_new], MIN_VARIANCE_PX2),
                ]
            ),
            static_weight=np.concatenate([window.landmarks.static_weight, np.ones(len(first_px))]),
            bias=bias,
        )
        # A frame that was dead-reckoned is no longer blind where features are found again.
        is_blind = window.is_blind.copy()
        is_blind[[prev, newest]] = False
        return replace(
            window,
            is_blind=is_blind,
            ids=np.concatenate([window.ids, tracks.ids[is_new]]),
            landmarks=landmarks,
            observations=merged(window.observations, new, np.concatenate([rows[is_new], rows])),
        )

    def _with_found_again(self, window: Window, found: SolvedTracks, tracks: Tracks) -> Window:
        """Return the window with features in its newest frame that an earlier one saw.

        Args:
            window: K frames.
            found: their tracks from that frame.
            tracks: those from the frame before; a feature that is among them counts only once.
        """
        features = self._features_of(found)
        if features is None:
            return window
        found_tracks, noise = features
        others = np.flatnonzero(~np.isin(found_tracks.ids, tracks.ids))
        return self._with_tracks(
            window, found_tracks.subset(others), noise.subset(others), prev=window.slot(found.prev)
        )

    def adjusted(self, window: Window) -> Window:
        """Minimise the cost over poses, rig and landmarks by Levenberg–Marquardt, with the Fisher
        information of the robust loss as the Hessian.

        The increments descend the tempered cost, but are accepted by the untempered one. One may
        therefore raise that by what its own quadratic model predicts.
        """
        # Which landmarks seem to move by themselves is decided before, so that the cost to minimise
        # is one and the same in all iterations.
        window = self._with_static_weights(window)
        # It is plain Gauss–Newton until an increment has raised the cost. ``candidate`` is the
        # window to return; it is ahead of ``system`` only after the last, small increment.
        system = self._system(window)
        candidate = window
        damping = 0.0
        prev_decrease = 0.0
        for _ in range(self._config.max_iterations):
            increment, decrease = self._increment(system, damping)
            candidate = self._incremented(system, increment)
            # Where decreases shrink by a factor from one to the next, those to come add up to this.
            remaining = decrease
            if prev_decrease > 0.0:
                remaining = decrease * min(1.0, decrease / prev_decrease)
            prev_decrease = decrease
            if damping == 0.0 and remaining < CONVERGED_BELOW:
                # Cost and curvature hardly change any more, and need not be formed again.
                break
            # Accept, and damp less, or go back, and damp more.
            candidate_system = self._system(candidate)
            hessian, gradient = system.equations
            predicted_rise = max(0.0, float(increment @ (0.5 * hessian @ increment - gradient)))
            if candidate_system.cost <= system.cost + predicted_rise + COST_TOLERANCE:
                system = candidate_system
                damping = 0.1 * damping if damping > MIN_DAMPING else 0.0
            else:
                damping = max(MIN_DAMPING, 10.0 * damping)
                candidate = system.window
        # The covariance is that of the last equations formed, at most that small increment before.
        cov, cov_of_motions = self._covariances(system.equations.hessian)
        of_imu = candidate.inertial.with_covariance(system.inertial, cov)
        return replace(candidate, cov=cov, cov_of_motions=cov_of_motions, inertial=of_imu)

    def without_oldest(self, window: Window) -> Window:
        """Return the window without its oldest frame, whose information goes into the prior.

        With the frame go the landmarks that it saw. Those that the last frame still sees begin
        anew with their last observation, which ends the one landmark and begins the next, as it
        does in a chain of motions of two frames. Without it, nothing would connect the last two
        frames where all landmarks are of one age.
        """
        observations = window.observations
        rows = window.landmark_rows
        # Which landmarks leave, and which of them begin anew.
        # Landmarks of the oldest frame are anchored in it, and leave with all their observations.
        is_old = observations.slot[observations.start[:-1]] == 0
        is_alive = is_old & (window.last_seen == len(window) - 1)
        is_last = np.zeros(len(rows), np.bool_)
        is_last[observations.start[1:] - 1] = True
        begins_anew = is_last & is_alive[rows]  # of which that observation stays, too
        # G of those that share a frame's jitter: the effective number of ages, (Σ n)²/Σ n². A
        # frame's observations of one age have the same anchor frame, and so leave at the same time.
        seen_at_age = np.bincount(window.age, minlength=1)
        groups = max(1.0, seen_at_age.sum() ** 2 / max(1, (seen_at_age**2).sum()))
        # The normal equations of these landmarks and the prior alone, without the IMU, whose first
        # factor is marginalised with them below.
        system = self._system(
            replace(
                window,
                observations=selected(observations, is_old[rows]),
                landmarks=_selected_landmarks(window.landmarks, is_old),
                jitter_cov=groups * window.jitter_cov,
                inertial=Inertial.none(),
            )
        )
        # At the offsets x, gradient = η − Λ x of the new prior, so that η = gradient + Λ x. The
        # system has the old prior in it already.
        information = system.equations.hessian
        vector = system.equations.gradient + information @ window.offsets()
        # With inertial states, pose, velocity and biases of the frame are marginalised in one
        # block: the IMU's factor correlates them.
        is_first = np.arange(len(window)) == 0
        remaining = window.without_frames(is_first)
        marginalised = inertial_steps.marginalize_first_frame(window, system.equations)
        if marginalised is None:
            prior = without_poses(MarginalPrior(information, vector), is_first)
        else:
            prior, states = marginalised
            remaining = replace(remaining, inertial=replace(remaining.inertial, states=states))
        # The landmarks that begin anew are those of their last observation by itself.
        state = window.landmarks.state.copy()
        last_px = observations.pixels[observations.start[1:] - 1]
        state[is_alive] = self._first_states(last_px[is_alive], window.rig)
        stays = ~is_old | is_alive
        kept = selected(observations, ~is_old[rows] | begins_anew)
        return replace(
            remaining,
            prior=kept_positive(prior),
            ids=window.ids[stays],
            landmarks=_selected_landmarks(window.landmarks._replace(state=state), stays),
            observations=kept._replace(slot=kept.slot - 1),
        )

    def _first_states(self, pixels: FloatArray, rig: FloatArray) -> FloatArray:
        """Return the landmarks that N observations, [N, 4], px, show by themselves, [N, 4]."""
        camera = self._camera
        x, y = camera.normalized(pixels[:, 0], pixels[:, 1])
        x_r, _ = camera.normalized(pixels[:, 2], pixels[:, 3])
        # What the lenses move outwards is taken back at the observed place: it is only a start. The
        # disparity error of the rig is the true one minus the measured one, and added. δ starts at
        # zero, the mean of its prior.
        inwards = -rig[LENS] * (x * x + y * y)
        inwards_r = -rig[LENS] * (x_r * x_r + y * y)
        states = np.zeros((len(pixels), LANDMARK))
        states[:, 0] = pixels[:, 0] + camera.fu_px * x * inwards
        states[:, 1] = pixels[:, 1] + camera.fv_px * y * inwards
        states[:, 2] = states[:, 0] - (pixels[:, 2] + camera.fu_px * x_r * inwards_r)
        states[:, 2] += disparity_basis(pixels, camera) @ rig[:LENS]
        return states

    def _with_static_weights(self, window: Window) -> Window:
        """Return the window with each landmark tested for a motion of its own."""
        static_weight = static_weights(
            self._geometry(window), window.observations, window.landmarks, self._noise
        )
        return replace(window, landmarks=window.landmarks._replace(static_weight=static_weight))

    def _geometry(self, window: Window) -> WindowGeometry:
        return WindowGeometry(
            T_cam_world=window.T_cam_world,
            T_linear=window.T_linear,
            jitter=window.jitter,
            rig=window.rig,
            camera=self._intrinsics,
        )

    def _system(self, window: Window) -> _System:
        """Form the normal equations of a window, its prior included."""
        num_frames = len(window)
        size = FRAME * num_frames + RIG
        num_observations = len(window.observations.slot)
        num_landmarks = len(window.landmarks.state)
        # The prior ½ xᵀ Λ x − ηᵀ x has the gradient η − Λ x towards its optimum, and is itself
        # −½ xᵀ (η + η − Λ x).
        x = window.offsets()
        towards_prior = window.prior.vector - window.prior.information @ x
        equations = WindowEquations(hessian=np.zeros((size, size)), gradient=np.zeros(size))
        elimination = Elimination(
            coupling=np.empty((num_observations, LANDMARK, FRAME)),
            rig_coupling=np.empty((num_landmarks, LANDMARK, RIG)),
            inverse=np.empty((num_landmarks, LANDMARK, LANDMARK)),
            gradient=np.empty((num_landmarks, LANDMARK)),
        )
        # The features first: landmarks are eliminated while their equations are summed.
        cost = accumulate(
            self._geometry(window),
            window.observations,
            window.landmarks,
            noise=self._noise,
            equations=equations,
            elimination=elimination,
        )
        # Eliminate the jitters; what remains are equations of poses and rig, [6K + 4].
        reduced, jitter, jitter_cost = eliminate_jitter(window, equations)
        cost += jitter_cost - 0.5 * float(x @ (window.prior.vector + towards_prior))
        hessian = reduced.hessian + window.prior.information
        gradient = reduced.gradient + towards_prior
        of_imu = inertial_steps.system_of(window)
        if of_imu is not None:  # its velocities, biases and gravity are eliminated, too
            imu_hessian, imu_gradient = of_imu.reduced()
            cost += of_imu.cost
            hessian += imu_hessian
            gradient += imu_gradient
        return _System(
            window=window,
            cost=cost,
            equations=WindowEquations(hessian=hessian, gradient=gradient),
            elimination=elimination,
            jitter=jitter,
            inertial=of_imu,
        )

    def _increment(self, system: _System, damping: float) -> tuple[FloatArray, float]:
        """Solve for the increment of poses and rig, [6K + 4], with tempered information about the
        rig.

        Returns:
            The increment, and its product with the gradient that it follows, the tempered one:
            about twice the decrease of the tempered cost.
        """
        hessian, gradient = system.equations
        poses = slice(None, -RIG)
        rig = slice(-RIG, None)
        # H_pp⁻¹ (H_pr, g_p), damped by a share of the diagonal of H_pp (Marquardt's scaling).
        damped = hessian[poses, poses] + damping * np.diag(np.diagonal(hessian)[poses])
        right_hand_sides = np.column_stack([hessian[poses, rig], gradient[poses]])
        try:
            solved = np.linalg.solve(damped, right_hand_sides)
        except np.linalg.LinAlgError:
            solved = pose_covariance(damped).in_world @ right_hand_sides
        # The rig first, by the Schur complement S = H_rr − H_rp H_pp⁻¹ H_pr, tempered by 1/c: with
        # its prior information Λ, (Λ + S/c) δr = (g_r − H_rp H_pp⁻¹ g_p)/c − Λ r. Then the poses
        # for it, δp = H_pp⁻¹ (g_p − H_pr δr).
        gain = solved[:, :RIG]
        rig_information = hessian[rig, rig] - hessian[rig, poses] @ gain
        rig_gradient = gradient[rig] - gain.T @ gradient[poses]
        tempered = rig_gradient / CORRELATED_FEATURES - self._rig_information @ system.window.rig
        of_rig = self._rig_covariance(rig_information) @ tempered
        decrease = gradient[poses] @ solved[:, RIG] + of_rig @ tempered
        return np.concatenate([solved[:, RIG] - gain @ of_rig, of_rig]), float(decrease)

    def _covariances(self, hessian: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the joint covariance of poses and rig, and the one for motions between the poses.

        Both are [6K + 4, 6K + 4]; the rig's is tempered.
        """
        poses = slice(None, -RIG)
        in_world, of_motions = pose_covariance(hessian[poses, poses])
        cov = self._with_rig(in_world, hessian)
        # They are the same unless the position in the world is as good as unknown.
        return cov, cov if of_motions is in_world else self._with_rig(of_motions, hessian)

    def _with_rig(self, of_poses: FloatArray, hessian: FloatArray) -> FloatArray:
        """Return the joint covariance of poses and rig, [6K + 4, 6K + 4].

        Args:
            of_poses: covariance of the poses for a rig that is known exactly, [6K, 6K].
            hessian: of poses and rig, [6K + 4, 6K + 4].
        """
        poses = slice(None, -RIG)
        rig = slice(-RIG, None)
        # The inverse by blocks: with the gain G = H_pp⁻¹ H_pr and the tempered covariance Σ_rr of
        # the rig, Σ_pp = H_pp⁻¹ + G Σ_rr Gᵀ and Σ_pr = −G Σ_rr.
        gain = of_poses @ hessian[poses, rig]
        information = hessian[rig, rig] - hessian[rig, poses] @ gain
        rig_cov = self._rig_covariance(information)
        cov = np.empty_like(hessian)
        cov[poses, poses] = of_poses + gain @ rig_cov @ gain.T
        cov[poses, rig] = -gain @ rig_cov
        cov[rig, poses] = cov[poses, rig].T
        cov[rig, rig] = rig_cov
        return cov

    def _rig_covariance(self, information: FloatArray) -> FloatArray:
        """Return (Λ + S/c)⁻¹ for the information S about the rig, [4, 4], and its prior's, Λ.

        No observation makes the rig less certain than the prior. Where the window knows next to
        nothing of its position, rounding may leave an S that is negative.
        """
        # In units of the prior's standard deviations, Λ is the identity.
        sigma = np.diagonal(self._rig_information) ** -0.5
        in_units = sigma[:, None] * information * sigma / CORRELATED_FEATURES
        values, directions = np.linalg.eigh(in_units)
        directions = sigma[:, None] * directions
        return np.asarray(directions / (1.0 + np.maximum(values, 0.0)) @ directions.T)

    def _incremented(self, system: _System, increment: FloatArray) -> Window:
        """Return the window after an increment of poses and rig; the landmarks follow."""
        window = system.window
        # Back-substitution in the reverse order of the elimination: jitters, then landmarks.
        of_jitters = system.jitter.offset - system.jitter.gain @ increment
        at_jitter, at_others = jitter_columns(len(window))
        of_all = np.empty(FRAME * len(window) + RIG)
        of_all[at_jitter] = of_jitters
        of_all[at_others] = increment
        state = np.empty_like(window.landmarks.state)
        move_landmarks(
            window.landmarks.state, window.observations, system.elimination, of_all, state
        )
        # T ← Exp(ξ) T for each pose.
        T_cam_world = se3.exp(increment[:-RIG].reshape(-1, POSE)) @ window.T_cam_world
        # First-estimates Jacobians: a pose in the prior keeps its linearisation point. One of which
        # the prior says nothing yet may be linearised where it is.
        known = np.diagonal(window.prior.information)[:-RIG].reshape(-1, POSE)
        is_fixed = known.max(axis=1) > 0.0
        return replace(
            window,
            T_cam_world=T_cam_world,
            T_linear=np.where(is_fixed[:, None, None], window.T_linear, T_cam_world),
            rig=window.rig + increment[-RIG:],
            jitter=window.jitter + of_jitters.reshape(-1, JITTER),
            inertial=window.inertial.after_increment(system.inertial, increment),
            landmarks=window.landmarks._replace(state=state),
        )


def _bounded(motion: RelativePose) -> RelativePose:
    """Return a measured motion that is as if known to ``MAX_UNKNOWN``, where it is known less."""
    # Scaling rows and columns alike keeps the correlations.
    sigma = np.sqrt(np.diagonal(motion.covariance))
    if (sigma <= MAX_UNKNOWN).all():
        return motion
    factor = np.minimum(1.0, MAX_UNKNOWN / sigma)
    cov = factor[:, None] * motion.covariance * factor
    return RelativePose(motion.T_curr_prev, cov, motion.curr, motion.prev)


def _rows_of(window: Window, ids: IntArray, slot: int) -> IntArray:
    """Return the landmark of each identity, [N], among those that a frame was the last to see; −1
    for none."""
    alive = np.flatnonzero(window.last_seen == slot)
    rows = rows_of(ids, window.ids[alive])
    is_known = rows >= 0
    rows[is_known] = alive[rows[is_known]]
    return rows


def _selected_landmarks(landmarks: WindowLandmarks, keep: BoolArray) -> WindowLandmarks:
    return WindowLandmarks(
        state=landmarks.state[keep],
        error_information=landmarks.error_information[keep],
        static_weight=landmarks.static_weight[keep],
        bias=landmarks.bias[keep],
    )
