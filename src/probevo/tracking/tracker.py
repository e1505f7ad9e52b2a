"""The tracker protocol. A tracker is stateless: it maps a state and a frame to a new state."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.sequences.frame import Frame
from probevo.sequences.prepared_images import Pyramid
from probevo.tracking.anchor_patches import AnchorPatches
from probevo.tracking.fixed_features import are_still
from probevo.tracking.observations import FrameObservations
from probevo.tracking.tracks import Tracks


@dataclass(frozen=True)
class TrackingState:
    """The N features tracked into the last frame, frozen: a tracker returns a new state."""

    ids: IntArray
    """Identity of each, [N]."""
    pixels: FloatArray
    """Raw (u_l, v_l, u_r, v_r), [N, 4], px."""
    age: IntArray
    """Frames in a row that have seen each, [N]."""
    patches: AnchorPatches | None = None
    """Anchor patch of each; None without images."""
    left: Pyramid = ()
    """Pyramid of the left image; empty without images, and without features."""
    next_id: int = 0
    """The identity that the next new feature gets."""
    num_matched_steps: int = 0
    """Steps of another front end with enough matches to tell left from right."""
    is_given: bool = False
    """Whether the features come from another front end, as in a tracks file."""
    fixed_ids: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    """Identities of those that are fixed to the vehicle (``estimation.vehicle_parts``), [F]."""

    @staticmethod
    def none(next_id: int = 0) -> TrackingState:
        """Return the state without any feature."""
        return TrackingState(
            ids=np.zeros(0, np.int64),
            pixels=np.zeros((0, 4)),
            age=np.zeros(0, np.int64),
            next_id=next_id,
        )

    def __len__(self) -> int:
        """Return the number of features, N."""
        return len(self.ids)

    def are_fixed(self, ids: IntArray) -> BoolArray:
        """Return which of N features, given by their identities, are fixed to the vehicle, [N]."""
        if not len(self.fixed_ids):
            return np.zeros(len(ids), np.bool_)
        return np.isin(ids, self.fixed_ids)

    def fixed_after(self, tracks: Tracks) -> IntArray:
        """Return the identities of those fixed features that their tracks, [N], leave where they
        are; one that has moved is not fixed any more."""
        return tracks.ids[self.are_fixed(tracks.ids) & are_still(tracks)]

    def subset(self, keep: BoolArray | IntArray) -> TrackingState:
        """Select some features by a mask, [N], or by indices."""
        return replace(
            self,
            ids=self.ids[keep],
            pixels=self.pixels[keep],
            age=self.age[keep],
            patches=None if self.patches is None else self.patches.subset(keep),
        )

    def without(self, ids: IntArray) -> TrackingState:
        """Drop features that turned out to be outliers, unless another front end tracks them."""
        if self.is_given or not len(ids):
            return self
        return self.subset(~np.isin(self.ids, ids))

    def observations(self, frame: Frame) -> FrameObservations:
        """Return what the frame observed, for the store."""
        return FrameObservations(
            frame=frame.index,
            stamp_ns=frame.stamp_ns,
            landmarks=self.ids,
            pixels=self.pixels,
        )


@dataclass(frozen=True)
class Tracked:
    """The result of a tracker for one frame."""

    tracks: Tracks
    """Features of the previous frame that were found again; raw observations."""
    state: TrackingState
    """All features of this frame, new ones included."""

    @property
    def tracks_of_scene(self) -> Tracks:
        """The tracks of the scene, without features that are fixed to the vehicle."""
        is_fixed = self.state.are_fixed(self.tracks.ids)
        return self.tracks.subset(~is_fixed) if is_fixed.any() else self.tracks

    @property
    def tracks_of_vehicle(self) -> Tracks:
        """The tracks of features that are fixed to the vehicle."""
        return self.tracks.subset(self.state.are_fixed(self.tracks.ids))

    def with_fixed(self, ids: IntArray) -> Tracked:
        """Return the result with further features that are fixed to the vehicle."""
        fixed_ids = np.concatenate([self.state.fixed_ids, ids])
        return replace(self, state=replace(self.state, fixed_ids=fixed_ids))

    @staticmethod
    def all_lost(state: TrackingState) -> Tracked:
        """Return the result of having lost all features of that state."""
        emptied = replace(
            TrackingState.none(state.next_id),
            num_matched_steps=state.num_matched_steps,
            is_given=state.is_given,
        )
        return Tracked(Tracks.none(), emptied)


class Tracker(Protocol):
    """Finds the features of the last frame in the next one; it has no state of its own."""

    def track(self, state: TrackingState, frame: Frame, T_curr_prev: FloatArray) -> Tracked:
        """Find the features of the previous frame in this one.

        Args:
            state: features alive in the previous frame.
            frame: the current one.
            T_curr_prev: motion that the search starts from, [4, 4].
        """
