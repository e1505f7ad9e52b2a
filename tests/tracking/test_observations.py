"""The observation store: which landmark was observed where, raw, with the noise of its own time."""

import numpy as np

import probevo as pv
from probevo.noise import StereoNoise
from probevo.sequences.frame import Frame
from probevo.tracking.observations import MAX_FRAMES, FrameObservations, ObservationStore
from worlds import CAMERA, drive, misrectified, random_pixels


def observations(
    frame: int,
    landmarks: list[int],
    *,
    noise_landmarks: list[int] | None = None,
    seed: int = 0,
) -> FrameObservations:
    """Random pixels of these landmarks, and random noise of some of them."""
    rng = np.random.default_rng([seed, frame])
    noise = None
    if noise_landmarks is not None:
        count = len(noise_landmarks)
        noise = StereoNoise(
            scale=rng.uniform(0.1, 1.0, count)[:, None, None] * np.eye(4),
            dof=np.full(count, 5.0),
            bias=np.zeros((count, 4)),
            refers_to="observation",
        )
    return FrameObservations(
        frame=frame,
        stamp_ns=frame * 100_000_000,
        landmarks=np.array(landmarks),
        pixels=random_pixels(rng, len(landmarks)),
        noise=noise,
        noise_landmarks=None if noise_landmarks is None else np.array(noise_landmarks, np.int64),
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


def test_history_is_of_one_landmark_raw_and_with_the_noise_of_each_frame() -> None:
    """NaN where no noise was predicted: in the first frame, or for a landmark that was not used."""
    frames = [
        observations(3, [7, 4]),
        observations(4, [4, 7, 9], noise_landmarks=[7, 4]),
        observations(5, [9, 7], noise_landmarks=[9]),
        observations(6, [9], noise_landmarks=[9]),
        observations(7, [8, 9, 7], noise_landmarks=[9, 8, 7]),
    ]
    store = ObservationStore()
    for each in frames:
        store = store.with_frame(each)
    history = store.history(7)
    assert history.frames.tolist() == [3, 4, 5, 7]
    expected_px = [frames[0].pixels[0], frames[1].pixels[1], frames[2].pixels[1]]
    expected_px.append(frames[4].pixels[2])
    np.testing.assert_array_equal(history.pixels, expected_px)
    assert frames[1].noise is not None
    assert frames[4].noise is not None
    np.testing.assert_array_equal(history.scale[1], frames[1].noise.scale[0])
    np.testing.assert_array_equal(history.scale[3], frames[4].noise.scale[2])
    assert np.isnan(history.scale[[0, 2]]).all()


def test_an_unknown_landmark_has_no_history() -> None:
    history = ObservationStore().with_frame(observations(0, [1, 2])).history(5)
    assert history.frames.shape == (0,)
    assert history.pixels.shape == (0, 4)
    assert history.scale.shape == (0, 4, 4)


def test_noise_rows_are_found_by_identity() -> None:
    """In any order; −1 for landmarks of which none was predicted."""
    rng = np.random.default_rng(1)
    known = rng.permutation(3 * np.arange(40))
    frame = observations(0, list(range(120)), noise_landmarks=known.tolist())
    asked = rng.permutation(np.arange(-10, 130))
    row_of = {landmark: row for row, landmark in enumerate(known.tolist())}
    expected = [row_of.get(landmark, -1) for landmark in asked.tolist()]
    np.testing.assert_array_equal(frame.noise_rows(asked), expected)
    for without in (observations(0, [1, 2]), observations(0, [1, 2], noise_landmarks=[])):
        np.testing.assert_array_equal(without.noise_rows(np.array([1, 2])), [-1, -1])


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
