"""Tracks, raw and corrected by the current estimate of the rig's calibration."""

from __future__ import annotations

from dataclasses import dataclass, replace

from probevo.arrays import FloatArray
from probevo.camera.exposure_delay import without_delay
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.rolling_shutter import Twists, without_readout
from probevo.camera.stereo import StereoCamera
from probevo.tracking.tracks import Tracks


@dataclass(frozen=True)
class CorrectedTracks:
    """The tracks of a step, raw and corrected, and the calibration updated by their rows."""

    raw: Tracks
    """The tracks as the tracker found them."""
    prior_rig: RigCalibration | None
    """The calibration before this frame; None without self-calibration."""
    simultaneous: Tracks
    """The tracks with all places moved to the times of their frames: the exposure delay of the
    right camera and the readout of the rows are removed, and nothing else."""
    tracks: Tracks
    """The tracks corrected by all of the calibration."""
    rig: RigCalibration | None
    """The calibration, its row offsets updated by this frame's stereo matches."""
    delay_s: float
    """The exposure delay of the right camera that was removed; 0 while the velocity is unknown."""
    knows_velocity: bool
    """Whether the velocity at both frames is known, on which delay and readout depend."""

    @staticmethod
    def of(
        raw: Tracks,
        rig: RigCalibration | None,
        camera: StereoCamera,
        twists: Twists | None,
    ) -> CorrectedTracks:
        """Correct raw tracks by the rig's calibration, and update its row offsets with them.

        Args:
            raw: as tracked.
            rig: the calibration before this frame; None corrects nothing.
            camera: the rectified camera.
            twists: the velocities at the two frames; None if they are not known.
        """
        if rig is None:
            return CorrectedTracks(
                raw,
                prior_rig=None,
                simultaneous=raw,
                tracks=raw,
                rig=None,
                delay_s=0.0,
                knows_velocity=False,
            )
        # What delay and readout move depends on the velocity; while that is unknown, nothing is
        # removed.
        delay_s = 0.0
        simultaneous = raw
        if twists is not None:
            delay_s = rig.delay.delay_s
            simultaneous = _at_times_of_frames(raw, rig, camera, twists)
        # Row offsets need no motion, so every frame updates them, accepted or not.
        updated = rig.with_rows(simultaneous.curr_px, camera, novelty=raw.novelty)
        return CorrectedTracks(
            raw=raw,
            prior_rig=rig,
            simultaneous=simultaneous,
            tracks=simultaneous.corrected(updated, camera),
            rig=updated,
            delay_s=delay_s,
            knows_velocity=twists is not None,
        )

    @property
    def readout_s(self) -> float:
        """The readout time that was removed; 0 while the velocity is unknown."""
        if self.prior_rig is None or not self.knows_velocity:
            return 0.0
        return self.prior_rig.image.readout_s

    def at_twists(self, twists: Twists, camera: StereoCamera) -> CorrectedTracks:
        """Correct the same raw tracks again with better estimates of the velocities."""
        return CorrectedTracks.of(self.raw, self.prior_rig, camera, twists)


def _at_times_of_frames(
    raw: Tracks, rig: RigCalibration, camera: StereoCamera, twists: Twists
) -> Tracks:
    """Return the tracks with the exposure delay of the right camera and the readout of the rows
    removed, under the velocities at the two frames.

    Unless their change in this step has been estimated, these are interpolated between the means of
    steps. A camera that shakes has others, by about as much as the velocity changes in a step, and
    what delay and readout move is wrong by that.
    """
    if not rig.delay.delay_s and not rig.image.readout_s:
        return raw

    def moved(pixels: FloatArray, twist: FloatArray) -> FloatArray:
        """Return the observations of one frame, [N, 4], px, under the velocity there."""
        without_delay_px = without_delay(pixels, rig.delay.delay_s, twist, camera)
        return without_readout(
            without_delay_px, rig.image.readout_s, twist, camera, acceleration=twists.acceleration
        )

    curr_px = moved(raw.curr_px, twists.curr)
    velocity_error_px = None
    if not twists.are_estimated:
        velocity_error_px = curr_px - moved(raw.curr_px, twists.prev)
    return replace(
        raw,
        prev_px=moved(raw.prev_px, twists.prev),
        curr_px=curr_px,
        velocity_error_px=velocity_error_px,
    )
