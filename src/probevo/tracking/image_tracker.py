"""Stereo images → tracks: corners followed by Lucas–Kanade, in time and from left to right (thesis
3.2.2)."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import BoolArray, FloatArray, Image, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.compiled import compiled
from probevo.config import TrackingConfig
from probevo.sequences.frame import Frame
from probevo.tracking.anchor_patches import AnchorPatches
from probevo.tracking.detection import corners_in_free_cells, non_overlapping
from probevo.tracking.lucas_kanade import Pyramid, track_points
from probevo.tracking.preparation import PreparedImages, prepare_images
from probevo.tracking.tracks import Tracks


@dataclass(frozen=True)
class _Followed:
    """Features alive in the last frame."""

    left: Pyramid
    pixels: FloatArray  # [N, 4]
    ids: IntArray
    age: IntArray
    windows: AnchorPatches
    same: BoolArray  # whether each still looks as at first sight, in both images
    next_id: int

    @staticmethod
    def none(left: Pyramid, config: TrackingConfig) -> _Followed:
        nobody = np.zeros(0, np.int64)
        windows = AnchorPatches.cut(left[0], np.zeros((0, 2)), config.window_px)
        return _Followed(
            left,
            np.zeros((0, 4)),
            nobody,
            age=nobody,
            windows=windows,
            same=np.zeros(0, np.bool_),
            next_id=0,
        )

    def kept(self, keep: BoolArray | IntArray) -> _Followed:
        arrays = (
            self.pixels[keep],
            self.ids[keep],
            self.age[keep],
            self.windows.subset(keep),
            self.same[keep],
        )
        return _Followed(self.left, *arrays, self.next_id)

    def renamed(self) -> _Followed:
        """What does not look as at first sight is taken for another point from there on."""
        others = ~self.same
        ids = self.ids.copy()
        age = self.age.copy()
        ids[others] = self.next_id + np.arange(others.sum())
        age[others] = 1
        return replace(self, ids=ids, age=age, next_id=self.next_id + int(others.sum()))


class ImageTracker:
    """Follows corners through a stereo recording.

    Args:
        camera: the rectified camera.
        config: settings of detection and tracking.
    """

    def __init__(self, camera: StereoCamera, config: TrackingConfig) -> None:
        self._camera = camera
        self._config = config
        self._before: _Followed | None = None
        self._now: _Followed | None = None
        self._now_stamp_ns: int | None = None
        self._images: PreparedImages | None = None

    def track(self, frame: Frame, expected: FloatArray) -> Tracks:
        """The features of the previous frame that are found in this one. Called again for a frame,
        it starts over.

        Args:
            frame: with both images.
            expected: T_curr_prev that the search starts from, [4, 4].
        """
        if self._images is None or frame.stamp_ns != self._now_stamp_ns:
            self._images = prepare_images(frame, self._config)
            self._before = self._now
            self._now_stamp_ns = frame.stamp_ns
        left = self._images.left
        right = self._images.right
        rejected: Counter[str] = Counter()
        before = (self._before or _Followed.none(left, self._config)).renamed()
        next_id = before.next_id
        followed = self._follow_in_time(before, left, expected, rejected=rejected)
        before, windows, left_px, disparity, difference, same = followed
        corners = corners_in_free_cells(
            self._images.corners, left_px, left[0].shape, config=self._config
        )
        all_px = np.vstack([left_px, corners])
        right_px, windows, matched, difference_right, same_right = self._match_right(
            left,
            right,
            all_px,
            disparity=np.r_[disparity, _of_nearest(corners, left_px, disparity)],
            windows=windows.joined(AnchorPatches.cut(left[0], corners, self._config.window_px)),
            num_followed=len(left_px),
            rejected=rejected,
        )
        survived = matched[: len(left_px)]
        born = matched[len(left_px) :]
        num = int(survived.sum())
        num_born = int(born.sum())
        self._now = now = _Followed(
            left,
            np.hstack([all_px[matched], right_px]),
            np.r_[before.ids[survived], next_id + np.arange(num_born)],
            age=np.r_[before.age[survived] + 1, np.ones(num_born, np.int64)],
            windows=windows,
            same=np.r_[same[survived], np.ones(num_born, np.bool_)] & same_right,
            next_id=next_id + num_born,
        )
        differences = np.column_stack([difference[survived], difference_right[:num]])
        return Tracks(
            before.pixels[survived],
            now.pixels[:num],
            now.ids[:num],
            age=now.age[:num],
            rejected=dict(rejected),
            difference=differences,
        )

    def drop(self, ids: IntArray) -> None:
        """Stop following these features: they turned out to be outliers."""
        if self._now is not None and len(ids):
            self._now = self._now.kept(~np.isin(self._now.ids, ids))

    def _follow_in_time(
        self, before: _Followed, left: Pyramid, expected: FloatArray, rejected: Counter[str]
    ) -> tuple[_Followed, AnchorPatches, FloatArray, FloatArray, FloatArray, BoolArray]:
        """Features found again: what they were; now windows, (u, v) [N, 2], expected disparity [N],
        difference [N], and whether the first sight fits, [N]."""
        predicted, growth, ahead = _predict(before.pixels, expected, self._camera)
        visible = ahead & _inside(predicted, left[0])
        rejected["left the view"] += int((~visible).sum())
        seen = np.flatnonzero(visible)
        found_px, difference = track_points(
            before.left,
            left,
            before.pixels[seen, :2],
            start_px=predicted[seen],
            config=self._config,
        )
        inside = _inside(found_px, left[0])
        rejected["left the view"] += int((~inside).sum())
        alike = _alike(difference, inside, self._config)
        rejected["looks different"] += int((inside & ~alike).sum())
        before = before.kept(seen[alike])
        growth = growth[seen[alike]]
        difference = difference[alike]
        found_px, fitted, windows = before.windows.align_left(left[0], found_px[alike], growth)
        same = np.isfinite(fitted)
        difference = np.where(same, fitted, difference)
        alone = non_overlapping(
            found_px, left[0].shape, self._config
        )  # of two, the older one: it comes first
        rejected["met another"] += int((~alone).sum())
        before = before.kept(alone)
        windows = windows.subset(alone)
        found_px = found_px[alone]
        disparity = growth[alone] * np.maximum(before.pixels[:, 0] - before.pixels[:, 2], 0.0)
        return before, windows, found_px, disparity, difference[alone], same[alone]

    def _match_right(
        self,
        left: Pyramid,
        right: Pyramid,
        left_px: FloatArray,
        disparity: FloatArray,
        windows: AnchorPatches,
        num_followed: int,
        rejected: Counter[str],
    ) -> tuple[FloatArray, AnchorPatches, BoolArray, FloatArray, BoolArray]:
        """Of N points in the left image, the followed ones first, those M that pass the checks: (u,
        v) in the right one, [M, 2], their windows, which they are, [N], how different they look,
        [M], and whether the first sight fits, [M]."""
        start = left_px - np.column_stack([disparity, np.zeros(len(disparity))])
        followed = np.arange(len(left_px)) < num_followed  # their disparities are about known
        right_px, difference = track_points(
            left, right, left_px, start_px=start, config=self._config, near=followed
        )
        level, ahead = self._consistent(left_px, right_px)
        rejected["rows differ"] += int((~level).sum())
        rejected["negative disparity"] += int(
            (level & ~ahead & (right_px[:, 0] > left_px[:, 0])).sum()
        )
        rejected["too little disparity"] += int(
            (level & ~ahead & (right_px[:, 0] <= left_px[:, 0])).sum()
        )
        matched = _alike(difference, level & ahead, self._config)
        rejected["no stereo match"] += int((level & ahead & ~matched).sum())
        fitted_px, fitted, windows = windows.subset(matched).align_right(
            right[0], right_px[matched]
        )
        still = np.logical_and(*self._consistent(left_px[matched], fitted_px))
        right_px = np.where(still[:, None], fitted_px, right_px[matched])
        difference = np.where(np.isfinite(fitted), fitted, difference[matched])
        return right_px, windows, matched, difference, np.isfinite(fitted) & still

    def _consistent(self, left_px: FloatArray, right_px: FloatArray) -> tuple[BoolArray, BoolArray]:
        """Which matches [N, 2] are in about the same row, and which are far enough to the left,
        [N]."""
        level: BoolArray = np.abs(right_px[:, 1] - left_px[:, 1]) <= self._config.max_row_offset_px
        ahead: BoolArray = left_px[:, 0] - right_px[:, 0] >= self._config.min_disparity_px
        return level, ahead


def _predict(
    pixels: FloatArray, T_curr_prev: FloatArray, camera: StereoCamera
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Where a motion takes features [N, 4]: (u, v) [N, 2], how they grow [N], and whether ahead of
    the camera [N]."""
    q, _ = camera.moved_rays(pixels, T_curr_prev)
    ahead: BoolArray = q[2] > 0.05
    growth = 1.0 / np.where(ahead, q[2], 1.0)
    u = camera.fu_px * q[0] * growth + camera.cu_px
    v = camera.fv_px * q[1] * growth + camera.cv_px
    return np.column_stack([u, v]), growth, ahead


@compiled
def _of_nearest(corners: FloatArray, left_px: FloatArray, disparity: FloatArray) -> FloatArray:
    """Disparity [M] to start with at new corners [M, 2]: the one [N] expected of the nearest
    feature [N, 2]."""
    found = np.zeros(len(corners))
    for m in range(len(corners)):
        nearest = np.inf
        for n in range(len(left_px)):
            du = left_px[n, 0] - corners[m, 0]
            dv = left_px[n, 1] - corners[m, 1]
            if du * du + dv * dv < nearest:
                nearest = du * du + dv * dv
                found[m] = disparity[n]
    return found


def _alike(difference: FloatArray, candidates: BoolArray, config: TrackingConfig) -> BoolArray:
    """Which of the candidates [N] look the same in both windows: little difference, or among the
    least different quarter.

    The quarter is one of the features wanted: where everything has changed, by a large step or
    blur, some must go on.
    """
    ranked = np.sort(difference[candidates & np.isfinite(difference)])
    enough = config.num_features // 4
    limit = ranked[min(enough, len(ranked)) - 1] if len(ranked) else 0.0
    alike: BoolArray = candidates & (difference <= max(config.max_difference, float(limit)))
    return alike & np.isfinite(difference)


def _inside(pixels: FloatArray, image: Image, border_px: float = 5.0) -> BoolArray:
    height, width = image.shape
    far_corner = np.array([width, height]) - border_px
    inside: BoolArray = np.all((pixels >= border_px) & (pixels < far_corner), axis=1)
    return inside
