"""The results that the stages of a step pass to each other, from the images to the solve."""

from __future__ import annotations

from dataclasses import dataclass, replace

from probevo.arrays import FloatArray
from probevo.estimation.frozen_images import Repetition
from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.estimation.recovery import STATUSES_WITHOUT_FEATURES, Recovery
from probevo.estimation.self_calibration import CalibratedMotion
from probevo.estimation.visual_motion import VisualMotion
from probevo.estimation.window.estimator import SolvedTracks
from probevo.measurements.base import Measurement
from probevo.measurements.sensor import Reading
from probevo.prediction import Prediction
from probevo.sequences.missing_data import Defect, MissingData
from probevo.state import StepFeatures
from probevo.tracking import Tracked, Tracks
from probevo.tracking.corrected_tracks import CorrectedTracks
from probevo.tracking.observations import FrameObservations
from probevo.tracking.repeated_images import shows_nothing


@dataclass(frozen=True)
class Observed:
    """The tracks and predictors of a frame, before a motion is estimated."""

    prediction: Prediction
    """The motion from which the search for the features started."""
    tracked: Tracked
    """The raw tracks, and the features to track from here on."""
    corrected_tracks: CorrectedTracks
    """The N tracks of the scene, corrected by the rig's calibration."""
    phi: FloatArray
    """The predictors of these tracks, [N, M]."""
    repetition: Repetition
    """Whether the images repeat those of the previous frame; if they are frozen, there are no
    tracks."""

    @property
    def is_frozen(self) -> bool:
        """Whether the images do not change although the camera moves."""
        return self.repetition is Repetition.FROZEN

    @property
    def missing(self) -> tuple[MissingData, ...]:
        """What tracking has found that the frame lacks."""
        if self.repetition is not Repetition.NONE and not shows_nothing(self.prediction.frame):
            return (MissingData(Defect.REPEATED_IMAGES, 1, 1),)
        return ()


@dataclass(frozen=True)
class Measured:
    """The measurements of the gyro and of the user's sensors."""

    gyro_measurements: list[Measurement]
    """The gyro's rotation, which enters the solve; only with ``gyro.prior``."""
    motion_measurements: list[Measurement]
    """The sensors' measurements of the motion, which enter the solve, too."""
    readings: list[Reading]
    """The answer of each sensor, measurements of the pose included."""


@dataclass(frozen=True)
class Solved:
    """The motion of a step and the calibration of the rig, estimated from its tracks."""

    observed: Observed
    calibrated: CalibratedMotion
    recovery: Recovery | None = None
    """Set if the motion starts at the last usable frame instead of the previous one."""
    reacquired: SolvedTracks | None = None
    """Tracks from the last usable frame, if they are found again in a step that is solved from the
    previous one: they connect the path across the dead-reckoned frames."""

    @property
    def visual(self) -> VisualMotion:
        """The motion by the tracks, and whether it was accepted."""
        return self.calibrated.visual

    @property
    def tracks_for_window(self) -> SolvedTracks:
        """The tracks from the frame where the motion starts, as the window takes them."""
        return SolvedTracks(
            self.prediction.state.frame.index,
            self.calibrated,
            span_factor=1.0 if self.recovery is None else self.recovery.span_factor,
        )

    @property
    def prediction(self) -> Prediction:
        """The prediction that it was solved with; after a recovery, that from the last usable
        frame."""
        return self.observed.prediction

    @property
    def tracks(self) -> Tracks:
        """The N tracks, corrected as they were solved."""
        return self.calibrated.corrected_tracks.tracks

    @property
    def is_lost(self) -> bool:
        """Whether the features were lost in images that are not just repeated."""
        return self.visual.status in STATUSES_WITHOUT_FEATURES and not self.observed.is_frozen

    @property
    def is_step_solved(self) -> bool:
        """Whether the motion from the previous frame to this one was solved from images."""
        return self.visual.status is Status.OK and self.recovery is None

    def from_previous_frame(self, motion: MotionEstimate) -> MotionEstimate:
        """Return the motion from the previous frame, given the motion that was solved, which after
        a recovery is that from the last usable frame."""
        return motion if self.recovery is None else self.recovery.path.closed(motion)

    def features(self, T_curr_prev: FloatArray) -> StepFeatures:
        """Return the tracks with predictors and weights, given the motion of the step, [4, 4]."""
        return StepFeatures(
            self.tracks,
            self.observed.phi,
            used=self.visual.used,
            weights=self.visual.weights,
            T_curr_prev=T_curr_prev,
            tracks_of_vehicle=self.observed.tracked.tracks_of_vehicle,
        )

    @property
    def observations(self) -> FrameObservations:
        """The raw observations, with the noise that was predicted for those used."""
        observations = self.observed.tracked.state.observations(self.prediction.frame)
        return replace(
            observations,
            noise=self.visual.noise,
            noise_landmarks=self.tracks.ids[self.visual.used],
        )
