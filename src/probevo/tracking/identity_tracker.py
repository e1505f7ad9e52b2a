"""Features of a tracks file → tracks: points are the same where their identities are."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.sequences.frame import Frame
from probevo.tracking.left_right import FRAMES_TO_SEE, MIN_MATCHES, check_features
from probevo.tracking.tracker import Tracked, TrackingState
from probevo.tracking.tracks import Tracks


class IdentityTracker:
    """Joins the features of consecutive frames by identity; an ``ImageTracker`` without images."""

    def track(self, state: TrackingState, frame: Frame, T_curr_prev: FloatArray) -> Tracked:
        """Return the features that the previous frame had, too; no search, and so no start.

        Args:
            state: features of the previous frame.
            frame: with features.
            T_curr_prev: not used.

        Raises:
            InputError: left and right of the first frames are swapped.
            ValueError: the frame has no features.
        """
        if frame.features is None:
            raise ValueError(f"frame {frame.index} has no features")
        # NaN: a feature that the front end has lost in one of the images.
        is_finite = np.isfinite(frame.features.pixels).all(axis=1)
        ids = frame.features.ids[is_finite]
        pixels = frame.features.pixels[is_finite]
        common, prev_rows, curr_rows = np.intersect1d(
            state.ids, ids, assume_unique=True, return_indices=True
        )
        # A feature that the previous frame lacked begins with an age of 1.
        age = np.ones(len(ids), np.int64)
        age[curr_rows] = state.age[prev_rows] + 1
        tracks = Tracks(
            prev_px=state.pixels[prev_rows],
            curr_px=pixels[curr_rows],
            ids=common,
            age=age[curr_rows],
            rejected={"not finite": int((~is_finite).sum())},
        )
        # Readers of recordings make this check earlier, and name the file. Later frames may show
        # nothing but points far away, whose disparities are noise.
        has_enough = len(tracks) >= MIN_MATCHES
        num_matched_steps = state.num_matched_steps + int(has_enough)
        if has_enough and num_matched_steps == FRAMES_TO_SEE + 1:
            check_features(tracks, f"features of frame {frame.index}")
        # All features of this frame, matched or not: the next frame may have them again.
        alive = TrackingState(
            ids=ids,
            pixels=pixels,
            age=age,
            is_given=True,
            fixed_ids=state.fixed_after(tracks),
            num_matched_steps=num_matched_steps,
        )
        return Tracked(tracks, alive)
