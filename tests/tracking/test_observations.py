"""The observation store: which landmark was observed where, raw."""

import numpy as np

import probevo as pv
from probevo.sequences.frame import Frame
from probevo.tracking.observations import MAX_FRAMES, FrameObservations, ObservationStore
from worlds import CAMERA, drive, misrectified, random_pixels


def observations(frame: int, landmarks: list[int]) -> FrameObservations:
    """Random pixels of these landmarks."""
    return FrameObservations(
        frame=frame,
        stamp_ns=frame * 100_000_000,
        landmarks=np.array(landmarks),
        pixels=random_pixels(np.random.default_rng(frame), len(landmarks)),
    )


def test_the_last_ten_frames_are_kept_in_order() -> None:
    store = ObservationStore()
    stores = []
    for index in range(25):
        store = store.with_frame(observations(index, [1, 2]))
        stores.append(store)
    assert MAX_FRAMES == 10
    assert [each.frame for each in store.frames] == list(range(15, 25))
    assert [each.frame for each in stores[3].frames] == [0, 1, 2, 3]  # a value: never changed


def test_the_odometry_stores_what_was_measured_not_what_was_corrected() -> None:
    """Of a misrectified pair: pixels as the frames have them, noise of all features used."""
    odometry = pv.StereoOdometry(CAMERA)
    frames = []
    for clean in drive(np.random.default_rng(3), 14):
        features = clean.features
        assert features is not None
        seen = type(features)(features.ids, misrectified(features.pixels))
        frames.append(Frame(clean.index, clean.stamp_ns, features=seen))
    for frame in frames:
        odometry.step(frame)
    state = odometry.state
    assert state is not None
    assert [each.frame for each in state.observations.frames] == list(range(4, 14))
    for each in state.observations.frames:
        features = frames[each.frame].features
        assert features is not None
        assert each.stamp_ns == frames[each.frame].stamp_ns
        place = {landmark: row for row, landmark in enumerate(features.ids.tolist())}
        rows = [place[landmark] for landmark in each.landmarks.tolist()]
        np.testing.assert_array_equal(each.pixels, features.pixels[rows])
    last = state.observations.frames[-1]
    np.testing.assert_array_equal(last.noise_landmarks, odometry.tracks.ids[odometry.used])
    assert last.noise is not None
    assert len(last.noise.dof) == odometry.used.sum()
