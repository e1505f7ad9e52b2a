"""Stereo images → tracks: corners followed by Lucas–Kanade, in time and from left to right (thesis
3.2.2)."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import BoolArray, FloatArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.compiled import compiled
from probevo.config import TrackingConfig
from probevo.config.odometry import DEFAULT_MAX_DIFFERENCE
from probevo.sequences.frame import Frame
from probevo.sequences.prepared_images import PreparedImages
from probevo.tracking.anchor_patches import AnchorPatches
from probevo.tracking.contrast import with_contrast_of
from probevo.tracking.detection import corners_in_free_cells, non_overlapping
from probevo.tracking.lucas_kanade import TrackedPoints, track_points
from probevo.tracking.preparation import prepare_images
from probevo.tracking.surface_motion import move_surfaces
from probevo.tracking.tracker import Tracked, TrackingState
from probevo.tracking.tracks import MASKED, NEGATIVE_DISPARITY, NO_MATCH, OTHER_ROW, Tracks
from probevo.tracking.uniqueness_numba import find_along_row, find_unique

AROUND_ALIGNED_PX = 2.5
"""How far a window that is aligned has to stay inside of the image: the spline needs its
neighbours, and the window may be stretched."""
MAX_DISPARITY = 0.25
"""Largest disparity at which a new corner is searched, in widths of the image.

With ordinary lenses, points at a depth of two to three baselines have it."""
ALIKE_ELSEWHERE = 6.0
"""Difference up to which a match with negative disparity, or in another row, counts as one, in grey
levels.

The gate of the tracks may be wider, since their history tells the wrong ones. Of swapped images, a
third to two thirds of these matches differ by less; of right ones, hardly any."""
LEFT_THE_VIEW = "left the view"
"""Why a feature is lost that the motion takes out of the image."""
NO_FIT = "no longer looks as at first sight"
"""Why a feature is lost whose image no longer matches its anchor patch."""


@dataclass(frozen=True)
class _TemporalMatches:
    """N features of the previous frame, found in the current left image."""

    prev: TrackingState
    """The same features in the previous frame, without their anchor patches."""
    left_px: FloatArray
    """(u, v) in the current left image, [N, 2], px."""
    patches: AnchorPatches
    disparity_px: FloatArray
    """Predicted disparity in the current frame, [N], px."""
    difference: FloatArray
    """Difference of image and anchor patch, [N], grey levels."""
    cov_px2: FloatArray
    """Covariance of the place by the alignment, [N, 2, 2], px²."""


@dataclass(frozen=True)
class Followed:
    """Features of the previous frame that are found in both images of this one, before new ones are
    looked for."""

    images: PreparedImages
    """The images of this frame."""
    tracks: Tracks
    alive: TrackingState
    """The features of the tracks in this frame, without their anchor patches."""
    patches: AnchorPatches
    """Anchor patches of the same features."""
    left_px: FloatArray
    """(u, v) of the features found in the left image, whether or not in the right one too, [N, 2],
    px."""
    disparity_px: FloatArray
    """Predicted disparity of these, [N], px."""

    @property
    def tracks_of_scene(self) -> Tracks:
        """The tracks of the scene, without features that are fixed to the vehicle."""
        return Tracked(self.tracks, self.alive).tracks_of_scene

    @property
    def num_left_the_view(self) -> int:
        """Number of features that the motion takes out of the image."""
        return self.tracks.rejected.get(LEFT_THE_VIEW, 0)


@dataclass(frozen=True)
class _StereoMatches:
    """M of N points in the left image, found in the right one."""

    matched: BoolArray
    """Which points these are, [N]."""
    right_px: FloatArray
    """(u, v) in the right image, [M, 2], px."""
    patches: AnchorPatches
    difference: FloatArray
    """Difference of image and anchor patch, [M], grey levels."""
    cov_px2: FloatArray
    """Covariance of the place by the alignment, [M, 2, 2], px²."""


class ImageTracker:
    """Follows corners through a stereo recording.

    Args:
        camera: the rectified camera.
        config: settings of detection and tracking.
    """

    def __init__(self, camera: StereoCamera, config: TrackingConfig) -> None:
        self._camera = camera
        self._config = config
        # Nearer to the border, a part of the window lies outside of the image.
        self._border_px = config.window_px // 2

    def track(self, state: TrackingState, frame: Frame, T_curr_prev: FloatArray) -> Tracked:
        """Find the features of the previous frame in this one, and new ones where there is room.

        Args:
            state: features alive in the previous frame.
            frame: with both images.
            T_curr_prev: motion that the search starts from, [4, 4].
        """
        return self.with_new_features(self.follow(state, frame, T_curr_prev))

    def follow(self, state: TrackingState, frame: Frame, T_curr_prev: FloatArray) -> Followed:
        """Find the features of the previous frame in this one; see ``track``."""
        images = prepare_images(frame, self._config)
        rejected: Counter[str] = Counter()
        # Match in the current left image, with predicted disparities, and from there in the right.
        temporal = self._match_in_time(state, images, T_curr_prev, rejected=rejected)
        stereo = self._match_in_stereo(
            images,
            temporal.left_px,
            temporal.patches,
            disparity_px=temporal.disparity_px,
            are_new=False,
            fewest=_fewest_to_go_on(self._config),
            rejected=rejected,
        )
        matched = stereo.matched
        # Only features with a stereo match go on.
        alive = TrackingState(
            ids=temporal.prev.ids[matched],
            pixels=np.hstack([temporal.left_px[matched], stereo.right_px]),
            age=temporal.prev.age[matched] + 1,
            left=images.left,
            next_id=state.next_id,
        )
        tracks = Tracks(
            prev_px=temporal.prev.pixels[matched],
            curr_px=alive.pixels,
            ids=alive.ids,
            age=alive.age,
            rejected=rejected,
            difference=np.column_stack([temporal.difference[matched], stereo.difference]),
            alignment_cov_px2=np.stack([temporal.cov_px2[matched], stereo.cov_px2], axis=1),
        )
        return Followed(
            images=images,
            tracks=tracks,
            alive=replace(alive, fixed_ids=state.fixed_after(tracks)),
            patches=stereo.patches,
            left_px=temporal.left_px,
            disparity_px=temporal.disparity_px,
        )

    def with_new_features(self, followed: Followed) -> Tracked:
        """Add new features where there is room."""
        images = followed.images
        image = images.left[0]
        # New corners in the cells that have room. The search for them in the right image starts
        # from the disparity of the nearest feature.
        corners = corners_in_free_cells(
            images.corners, followed.left_px, image.shape, config=self._config
        )
        rejected = Counter(followed.tracks.rejected)
        stereo = self._match_in_stereo(
            images,
            corners,
            AnchorPatches.cut(
                image, corners, self._config.window_px, saturated=images.left_spline.saturated
            ),
            disparity_px=_disparity_of_nearest(corners, followed.left_px, followed.disparity_px),
            are_new=True,
            fewest=max(_fewest_to_go_on(self._config) - len(followed.alive), 0),
            rejected=rejected,
        )
        # The features of the previous frame come first, then the new ones, which get an identity.
        alive = followed.alive
        num_new = len(stereo.right_px)
        state = replace(
            alive,
            ids=np.concatenate([alive.ids, alive.next_id + np.arange(num_new)]),
            pixels=np.vstack([alive.pixels, np.hstack([corners[stereo.matched], stereo.right_px])]),
            age=np.concatenate([alive.age, np.ones(num_new, np.int64)]),
            patches=followed.patches.joined(stereo.patches),
            next_id=alive.next_id + num_new,
        )
        return Tracked(replace(followed.tracks, rejected=dict(rejected)), state)

    def _match_in_time(
        self,
        prev: TrackingState,
        images: PreparedImages,
        T_curr_prev: FloatArray,
        *,
        rejected: Counter[str],
    ) -> _TemporalMatches:
        """Find the features of the previous frame in the current left image."""
        left = images.left
        image = left[0]
        patches = prev.patches
        if patches is None:
            patches = AnchorPatches.cut(image, np.zeros((0, 2)), self._config.window_px)
        # Predict where the motion takes them, and how it warps their windows. Lucas–Kanade
        # converges from a few pixels only.
        motion = move_surfaces(prev.pixels, patches.disparity_slope, T_curr_prev, self._camera)
        is_fixed = prev.are_fixed(prev.ids)
        if is_fixed.any():
            stay = move_surfaces(prev.pixels, patches.disparity_slope, np.eye(4), self._camera)
            motion = motion.where(~is_fixed, stay)
        # ``alive`` are the rows of the features that have passed all checks so far, in ``prev``,
        # ``patches`` and ``motion``.
        alive = np.flatnonzero(motion.ahead & _inside(motion.pixels, image, self._border_px))
        rejected[LEFT_THE_VIEW] += len(prev) - len(alive)
        # Lucas–Kanade from the previous image, which looks most alike. Its errors add up along the
        # track; the alignment below removes them.
        tracked = track_points(
            with_contrast_of(prev.left, left),
            left,
            prev.pixels[alive, :2],
            start_px=motion.pixels[alive],
            config=self._config,
        )
        inside = _inside(tracked.pixels, image, self._border_px)
        rejected[LEFT_THE_VIEW] += int((~inside).sum())
        if images.left_usable is not None:
            unmasked = _unmasked(tracked.pixels, images.left_usable)
            rejected[MASKED] += int((inside & ~unmasked).sum())
            inside &= unmasked
        fewest = _fewest_to_go_on(self._config)
        alike = _look_alike(tracked.difference, inside, self._config, fewest=fewest)
        rejected["looks different"] += int((inside & ~alike).sum())
        alive = alive[alike]
        # Align with the anchor patch, the image of the feature when it was first seen, which
        # removes the drift. If that fails, the window no longer shows the same point of the scene.
        aligned = patches.subset(alive).align_left(
            images.left_spline, tracked.pixels[alike], motion.subset(alive)
        )
        fits = np.isfinite(aligned.difference)
        border_px = self._border_px + AROUND_ALIGNED_PX
        is_whole = _inside(tracked.pixels[alike], image, border_px)
        rejected[NO_FIT] += int((~fits & is_whole).sum())
        rejected[LEFT_THE_VIEW] += int((~fits & ~is_whole).sum())
        # Where two features have converged on one point, keep the older one, which comes first.
        # Both would count as independent, although their errors are the same.
        kept = np.flatnonzero(fits)
        separate = non_overlapping(aligned.pixels[kept], image.shape, self._config)
        rejected["met another"] += int((~separate).sum())
        kept = kept[separate]
        alive = alive[kept]
        followed = replace(prev, patches=None).subset(alive)
        # d = f_u b/z grows as the depth shrinks. A negative one is noise: at infinity it is zero.
        prev_disparity_px = np.maximum(followed.pixels[:, 0] - followed.pixels[:, 2], 0.0)
        return _TemporalMatches(
            prev=followed,
            left_px=aligned.pixels[kept],
            patches=aligned.patches.subset(kept),
            disparity_px=motion.growth[alive] * prev_disparity_px,
            difference=aligned.difference[kept],
            cov_px2=aligned.cov_px2[kept],
        )

    def _match_in_stereo(
        self,
        images: PreparedImages,
        left_px: FloatArray,
        patches: AnchorPatches,
        *,
        disparity_px: FloatArray,
        are_new: bool,
        fewest: int,
        rejected: Counter[str],
    ) -> _StereoMatches:
        """Find N points of the left image in the right one.

        Args:
            images: the left and the right image.
            left_px: the points, (u, v), [N, 2], px.
            patches: anchor patch of each.
            disparity_px: predicted disparity, [N], px.
            are_new: whether these are new corners, whose disparity is only a guess; the others'
                disparity follows from the previous frame.
            fewest: how many must go on, however different they look.
            rejected: counts what each check rejects.
        """
        # Lucas–Kanade from the left to the right image, from the predicted disparity.
        left = images.left
        right = images.right
        # The row stays: the pair is rectified.
        start_px = left_px - np.column_stack([disparity_px, np.zeros(len(left_px))])
        tracked = track_points(
            left, right, left_px, start_px=start_px, config=self._config, are_near=not are_new
        )
        if are_new:
            tracked = self._with_row_search(images, left_px, tracked)
        # In a rectified pair, a match lies in nearly the same row, and not to the right.
        same_row = self._in_same_row(left_px, tracked.pixels)
        has_disparity = self._has_disparity(left_px, tracked.pixels)
        is_negative = same_row & ~has_disparity & (tracked.pixels[:, 0] > left_px[:, 0])
        # Where the true place is out of reach, Lucas–Kanade ends anywhere. Only a window that looks
        # alike there says that the point is seen in another row, or farther to the right.
        is_alike = tracked.difference <= ALIKE_ELSEWHERE
        rejected[OTHER_ROW] += int((~same_row & is_alike).sum())
        rejected[NEGATIVE_DISPARITY] += int((is_negative & is_alike).sum())
        rejected[NO_MATCH] += int(((~same_row | is_negative) & ~is_alike).sum())
        rejected["too little disparity"] += int((same_row & ~has_disparity & ~is_negative).sum())
        consistent = same_row & has_disparity
        if images.right_usable is not None:
            unmasked = _unmasked(tracked.pixels, images.right_usable)
            rejected[MASKED] += int((consistent & ~unmasked).sum())
            consistent &= unmasked
        alike = _look_alike(tracked.difference, consistent, self._config, fewest=fewest)
        rejected[NO_MATCH] += int((consistent & ~alike).sum())
        # Align with the anchor patch here, too, and check again: the alignment may have moved it.
        aligned = patches.subset(alike).align_right(images.right_spline, tracked.pixels[alike])
        fits = np.isfinite(aligned.difference)
        fits &= self._in_same_row(left_px[alike], aligned.pixels)
        fits &= self._has_disparity(left_px[alike], aligned.pixels)
        rejected[NO_FIT] += int((~fits).sum())
        # A new feature must not repeat along its row: nothing but its neighbours tells which of
        # the places is the true one. An old one was found there before.
        if are_new:
            unique = self._is_unique(images, left_px[alike][fits], aligned.pixels[fits])
            rejected["repeats along its row"] += int((~unique).sum())
            fits[fits] = unique
        # ``fits`` is over the points that look alike; scatter it over all N.
        matched = alike.copy()
        matched[alike] = fits
        return _StereoMatches(
            matched=matched,
            right_px=aligned.pixels[fits],
            patches=aligned.patches.subset(fits),
            difference=aligned.difference[fits],
            cov_px2=aligned.cov_px2[fits],
        )

    def _is_unique(
        self, images: PreparedImages, left_px: FloatArray, right_px: FloatArray
    ) -> BoolArray:
        """Return which of N stereo matches fit clearly better than other places in their row, [N].

        Noise makes all places of a row alike. In images of half the size it is half as large, and a
        window shows four times the area. Those that repeat there, too, are not unique.
        """
        unique = np.zeros(len(left_px), np.bool_)
        for level in range(min(2, len(images.left))):
            repeats = np.flatnonzero(~unique)
            scale = 0.5**level
            unique[repeats] = find_unique(
                images.left[level],
                images.right[level],
                scale * left_px[repeats],
                scale * right_px[repeats],
                window_px=self._config.window_px,
                outside=level == 0,  # half the size has no say where its windows do not fit
            )
        return unique

    def _with_row_search(
        self,
        images: PreparedImages,
        left_px: FloatArray,
        tracked: TrackedPoints,
    ) -> TrackedPoints:
        """Search those new corners along their rows that Lucas–Kanade has not found.

        The disparity of a new corner is a guess, and Lucas–Kanade reaches a few tens of pixels.
        Near points are beyond, as are many points at a high resolution or with a wide baseline. It
        goes in both directions, so that swapped images are recognised.

        Args:
            images: the left and the right image.
            left_px: N new corners in the left image, (u, v), [N, 2], px.
            tracked: where Lucas–Kanade has ended in the right image.

        Returns:
            All N corners; what the search has found is at its new place.
        """
        looks_alike = tracked.difference <= _gate(self._config)
        same_row = self._in_same_row(left_px, tracked.pixels)
        lost = np.flatnonzero(~(same_row & looks_alike))
        # Images of half the size have half as many places, windows cover more of them, and an error
        # of the rows is half as large.
        level = min(1, len(images.left) - 1)
        scale = 0.5**level
        width_px = images.left[level].shape[1]
        disparity_px = find_along_row(
            images.left[level],
            images.right[level],
            scale * left_px[lost],
            reach_px=round(MAX_DISPARITY * width_px),
            window_px=self._config.window_px,
        )
        is_unique = np.isfinite(disparity_px)
        lost = lost[is_unique]
        start_px = left_px[lost].copy()
        start_px[:, 0] -= disparity_px[is_unique] / scale
        # From there, Lucas–Kanade is left with a fraction of a pixel, and with the row offset.
        again = track_points(
            images.left,
            images.right,
            left_px[lost],
            start_px=start_px,
            config=self._config,
            are_near=True,
        )
        same_row = self._in_same_row(left_px[lost], again.pixels)
        is_found = same_row & (again.difference <= _gate(self._config))
        recovered = lost[is_found]
        pixels = tracked.pixels.copy()
        pixels[recovered] = again.pixels[is_found]
        difference = tracked.difference.copy()
        difference[recovered] = again.difference[is_found]
        return TrackedPoints(pixels, difference)

    def _in_same_row(self, left_px: FloatArray, right_px: FloatArray) -> BoolArray:
        """Return which matches [N, 2] lie in about the same row."""
        row_offset_px = np.abs(right_px[:, 1] - left_px[:, 1])
        same_row: BoolArray = row_offset_px <= self._config.max_row_offset_px
        return same_row

    def _has_disparity(self, left_px: FloatArray, right_px: FloatArray) -> BoolArray:
        """Return which matches [N, 2] have a disparity large enough for a depth."""
        disparity_px = left_px[:, 0] - right_px[:, 0]
        has_disparity: BoolArray = disparity_px >= self._config.min_disparity_px
        return has_disparity


@compiled
def _disparity_of_nearest(
    corners: FloatArray, left_px: FloatArray, disparity: FloatArray
) -> FloatArray:
    """Return the disparity [M] to start with at corners [M, 2]: the nearest feature's, [N]."""
    # Without any feature the search starts at infinity, where the disparity is 0.
    corner_disparity = np.zeros(len(corners))
    for m in range(len(corners)):
        nearest = np.inf
        for n in range(len(left_px)):
            du = left_px[n, 0] - corners[m, 0]
            dv = left_px[n, 1] - corners[m, 1]
            if du * du + dv * dv < nearest:
                nearest = du * du + dv * dv
                corner_disparity[m] = disparity[n]
    return corner_disparity


def _look_alike(
    difference: FloatArray, candidates: BoolArray, config: TrackingConfig, *, fewest: int
) -> BoolArray:
    """Return which of the candidates [N] look alike in both windows.

    These differ little, or are among the ``fewest`` least different ones: where everything has
    changed, by a large step or blur, some must go on.
    """
    candidates = candidates & np.isfinite(difference)
    least = np.sort(difference[candidates])[:fewest]
    largest = max(_gate(config), least[-1]) if len(least) else _gate(config)
    alike: BoolArray = candidates & (difference <= largest)
    return alike


def _fewest_to_go_on(config: TrackingConfig) -> int:
    """Return a quarter of the features wanted. A quarter of the features found would thin out few
    survivors."""
    return config.num_features // 4


def _gate(config: TrackingConfig) -> float:
    """Return the largest difference of windows that show the same feature, grey levels."""
    if config.max_difference is None:
        return DEFAULT_MAX_DIFFERENCE["two-frame"]
    return config.max_difference


def _unmasked(pixels: FloatArray, usable: BoolArray) -> BoolArray:
    """Return which (u, v), [N, 2], lie where features are usable, [height, width]; of those outside
    of the image, the nearest pixel counts."""
    height, width = usable.shape
    u, v = np.clip(np.rint(pixels), 0, [width - 1, height - 1]).astype(np.int64).T
    unmasked: BoolArray = usable[v, u]
    return unmasked


def _inside(pixels: FloatArray, image: Image, border_px: float) -> BoolArray:
    """Return which (u, v), [N, 2], lie inside the image, off its border."""
    height, width = image.shape
    far_corner = np.array([width, height]) - border_px
    inside: BoolArray = np.all((pixels >= border_px) & (pixels < far_corner), axis=1)
    return inside
