"""What the stages of a step hand to one another, from the images to the solve."""

from __future__ import annotations

from dataclasses import dataclass, replace

from probevo.arrays import FloatArray
from probevo.estimation.motion_estimate import Status
from probevo.estimation.recovery import LOST, Recovery
from probevo.estimation.self_calibration import CalibratedMotion
from probevo.estimation.visual_motion import VisualMotion
from probevo.measurements.base import Measurement
from probevo.measurements.sensor import Reading
from probevo.state import Prediction, StepFeatures
from probevo.tracking import Tracked, Tracks
from probevo.tracking.corrected_tracks import CorrectedTracks
from probevo.tracking.observations import FrameObservations


@dataclass(frozen=True)
class Observed:
    """What the images of a frame show, before a motion is estimated."""

    prediction: Prediction
    """Where the features were looked for."""
    tracked: Tracked
    """The raw tracks, and what the tracker is to remember."""
    corrected: CorrectedTracks
    """The N tracks, corrected by the rig's calibration."""
    phi: FloatArray
    """Their places in the prediction space, [N, M]."""
    is_frozen: bool
    """Whether the images stand still though the camera moves, so that there are no tracks."""


@dataclass(frozen=True)
class Measured:
    """What the sensors beside the camera measured."""

    of_motion: list[Measurement]
    """What enters the solve: the gyro's rotation, and what sensors measured of the motion."""
    readings: list[Reading]
    """What each sensor returned."""


@dataclass(frozen=True)
class Solved:
    """The motion of a step, and what its tracks say of the rig."""

    observed: Observed
    calibrated: CalibratedMotion
    recovery: Recovery | None = None
    """If the motion leads from the last usable frame instead of the previous one."""

    @property
    def visual(self) -> VisualMotion:
        """What the tracks say about the motion."""
        return self.calibrated.visual

    @property
    def tracks(self) -> Tracks:
        """The N tracks, corrected as they were solved."""
        return self.calibrated.corrected.tracks

    @property
    def is_lost(self) -> bool:
        """Whether the features were lost, though the images are those of another time."""
        return self.visual.status in LOST and not self.observed.is_frozen

    @property
    def shows_step(self) -> bool:
        """Whether the images show the motion from the previous frame to this one."""
        return self.visual.status is Status.OK and self.recovery is None

    def features(self, T_curr_prev: FloatArray) -> StepFeatures:
        """Return the tracks, and what became of them, given the motion of the step, [4, 4]."""
        return StepFeatures(
            self.tracks,
            self.observed.phi,
            used=self.visual.used,
            weights=self.visual.weights,
            T_curr_prev=T_curr_prev,
        )

    @property
    def observations(self) -> FrameObservations:
        """The raw observations, with the noise that was predicted for those used."""
        return replace(
            self.observed.tracked.state.observations(self.observed.prediction.frame),
            noise=self.visual.noise,
            noise_landmarks=self.tracks.ids[self.visual.used],
        )
