"""Tracks, raw and corrected by the current estimate of the rig's calibration."""

from __future__ import annotations

from dataclasses import dataclass, replace

from probevo.arrays import FloatArray
from probevo.camera.exposure_delay import without_delay
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.stereo import StereoCamera
from probevo.tracking.tracks import Tracks


@dataclass(frozen=True)
class CorrectedTracks:
    """The tracks of a step, raw and corrected, and the calibration updated by their rows."""

    raw: Tracks
    """As tracked."""
    prior_rig: RigCalibration | None
    """The calibration before this frame; None without self-calibration."""
    simultaneous: Tracks
    """With the exposure delay of the right camera removed, but otherwise raw."""
    tracks: Tracks
    """Corrected by all of the calibration."""
    rig: RigCalibration | None
    """The calibration, its row offsets updated by this frame's stereo matches."""
    delay_s: float
    """The exposure delay of the right camera that was removed; 0 while the velocity is unknown."""

    @staticmethod
    def of(
        raw: Tracks,
        rig: RigCalibration | None,
        camera: StereoCamera,
        *,
        prev_twist: FloatArray | None,
        curr_twist: FloatArray | None,
    ) -> CorrectedTracks:
        """Correct raw tracks by the rig's calibration, and update its row offsets with them.

        Args:
            raw: as tracked.
            rig: the calibration before this frame; None corrects nothing.
            camera: the rectified camera.
            prev_twist: twist per second at the previous frame, [6]; None if it is not known.
            curr_twist: the twist per second at this frame.
        """
        if rig is None:
            return CorrectedTracks(
                raw, prior_rig=None, simultaneous=raw, tracks=raw, rig=None, delay_s=0.0
            )
        # What the delay moves depends on the velocity; while that is unknown, nothing is removed.
        delay_s = 0.0
        simultaneous = raw
        if prev_twist is not None and curr_twist is not None:
            delay_s = rig.delay.delay_s
            simultaneous = _without_delay(raw, delay_s, camera, (prev_twist, curr_twist))
        # Row offsets need no motion, so every frame updates them, accepted or not.
        updated = rig.with_rows(simultaneous.curr_px, camera, novelty=raw.novelty)
        return CorrectedTracks(
            raw=raw,
            prior_rig=rig,
            simultaneous=simultaneous,
            tracks=simultaneous.corrected(updated, camera),
            rig=updated,
            delay_s=delay_s,
        )

    def at_twists(
        self, prev_twist: FloatArray, curr_twist: FloatArray, camera: StereoCamera
    ) -> CorrectedTracks:
        """Correct the same raw tracks again with better estimates of the velocity, [6] each."""
        return CorrectedTracks.of(
            self.raw,
            self.prior_rig,
            camera,
            prev_twist=prev_twist,
            curr_twist=curr_twist,
        )


def _without_delay(
    raw: Tracks, delay_s: float, camera: StereoCamera, twists: tuple[FloatArray, FloatArray]
) -> Tracks:
    """Return the tracks with the exposure delay of the right camera removed, under the velocities
    at the two frames, [6] each.

    These are interpolated between the means of steps. A camera that shakes has others, by about as
    much as the velocity changes in a step, and what the delay moves is wrong by that.
    """
    if not delay_s:
        return raw
    prev_twist, curr_twist = twists
    curr_px = without_delay(raw.curr_px, delay_s, curr_twist, camera)
    of_other_frame = without_delay(raw.curr_px, delay_s, prev_twist, camera)
    return replace(
        raw,
        prev_px=without_delay(raw.prev_px, delay_s, prev_twist, camera),
        curr_px=curr_px,
        right_error_px=curr_px[:, 2:] - of_other_frame[:, 2:],
    )
