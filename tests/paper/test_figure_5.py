"""PROBE Fig. 5: geometry, statistics, and a small version of the whole experiment."""

from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import f as f_distribution

from output.pages import Balance
from probevo_paper.figure_5 import (
    NUM_CORNERS,
    BlurObservations,
    BlurView,
    blur_views,
    find_corners,
    reproject,
    track,
)
from probevo_paper.figure_5_page import CSV_HEAD, counts_text, write_blur_page, write_csv
from probevo_paper.figure_5_scene import FAST, FRAME_STEP_S, LEFT, RIGHT, BoardScene
from probevo_paper.figure_5_statistics import (
    INSTANTS_PER_CLUSTER,
    Finding,
    findings,
    summarise,
    variance_ratio_interval,
    verdicts,
)

INSTANTS = 30
"""A quarter of the default."""
SEED = 0


@pytest.fixture(scope="module")
def scene() -> BoardScene:
    return BoardScene(8.0, np.random.default_rng(0))


@pytest.fixture(scope="module")
def views() -> list[BlurView]:
    return list(blur_views(INSTANTS, SEED))


@pytest.fixture(scope="module")
def observations(views: list[BlurView]) -> BlurObservations:
    return BlurObservations.of(views)


@pytest.fixture(scope="module")
def results(observations: BlurObservations) -> tuple[Finding, ...]:
    return findings(observations, np.random.default_rng(SEED))


def test_true_corners_reproject_onto_true_corners(scene: BoardScene) -> None:
    """Triangulating by the stereo rig and projecting into the fast camera undoes the projection."""
    t_s = np.linspace(0.0, 8.0, 9)
    left, right, fast = (scene.board(camera, t_s) for camera in (LEFT, RIGHT, FAST))
    np.testing.assert_allclose(reproject(np.concatenate([left, right], axis=-1)), fast, atol=1e-9)


@pytest.mark.parametrize("camera", [LEFT, RIGHT, FAST], ids=["left", "right", "fast"])
def test_corners_are_seen_where_they_are(scene: BoardScene, camera: object) -> None:
    """Corners detected in slow motion lie within noise of the projection, in the same order."""
    assert isinstance(camera, type(LEFT))
    window = scene.window(camera, [1.0])
    found_px = find_corners(scene.expose(camera, 1.0, window, np.random.default_rng(1)))
    assert found_px is not None
    error = found_px + window.corner_px - scene.board(camera, 1.0)
    assert np.abs(error).max() < 0.3
    assert np.abs(error.mean(axis=0)).max() < 0.05


def test_the_rig_moves_slowly_and_then_fast_with_the_board_in_view(scene: BoardScene) -> None:
    """All cameras see the whole board; its motion during an exposure grows, but below a square."""
    t_s = np.linspace(0.0, 8.0, 161)
    for camera in (LEFT, RIGHT, FAST):
        board_px = scene.board(camera, t_s, margin=1)
        assert (board_px > 0).all()
        assert (board_px < np.array(camera.size_px) - 1).all()
    moved_px = np.linalg.norm(
        scene.board(LEFT, t_s + 0.5 * LEFT.shutter_s)
        - scene.board(LEFT, t_s - 0.5 * LEFT.shutter_s),
        axis=-1,
    ).max(axis=1)
    slow = moved_px[t_s < 3.0]
    fast = moved_px[t_s > 5.0]
    assert slow.max() < 3.5
    assert np.median(fast) > 3 * np.median(slow)
    assert fast.max() < 23


def test_a_slowly_moving_corner_is_tracked_to_where_it_is(scene: BoardScene) -> None:
    window = scene.window(LEFT, [1.0, 1.0 - FRAME_STEP_S])
    rng = np.random.default_rng(2)
    previous = scene.expose(LEFT, 1.0 - FRAME_STEP_S, window, rng)
    current = scene.expose(LEFT, 1.0, window, rng)
    start_px = scene.board(LEFT, 1.0 - FRAME_STEP_S) - window.corner_px
    error = track(previous, current, start_px) + window.corner_px - scene.board(LEFT, 1.0)
    assert np.abs(error).max() < 0.4


def test_no_board_no_corners() -> None:
    assert find_corners(np.full((200, 300), 90, dtype=np.uint8)) is None


def test_the_standard_error_of_correlated_errors_is_the_spread_of_their_means() -> None:
    """Over 2,000 draws of errors that have most of their noise in common within a second."""
    rng = np.random.default_rng(0)
    instant = np.repeat(np.arange(100), 8)
    means = []
    claims = []
    for _ in range(2000):
        error = rng.normal(size=100 // INSTANTS_PER_CLUSTER)[
            instant // INSTANTS_PER_CLUSTER
        ] + 0.5 * rng.normal(size=len(instant))
        summary = summarise(error, instant)
        means.append(summary.mean_px)
        claims.append(summary.standard_error_px)
    assert np.mean(claims) == pytest.approx(np.std(means), rel=0.05)
    assert np.mean(claims) > 4 * 1.12 / np.sqrt(len(instant))


def test_the_interval_of_independent_normal_errors_is_that_of_the_f_test() -> None:
    rng = np.random.default_rng(1)
    instant = np.repeat(np.arange(500), 4)
    is_high = np.arange(len(instant)) % 2 == 1
    error = np.where(is_high, 2.0, 1.0) * rng.normal(size=len(instant))
    ratio = error[is_high].var() / error[~is_high].var()
    expected = ratio / f_distribution.ppf([0.975, 0.025], 999, 999)
    interval = variance_ratio_interval(error, instant, is_high, rng=np.random.default_rng(2))
    np.testing.assert_allclose(interval, expected, rtol=0.08)


def test_errors_stay_zero_mean_while_their_variance_grows(results: tuple[Finding, ...]) -> None:
    """Check PROBE Fig. 5 for both errors and axes.

    Every mean is within 3 standard errors, or below a tenth of σ. Each interval of a ratio of
    variances lies above 1, and the variance of both axes together doubles.
    """
    assert [(finding.kind, finding.axis) for finding in results] == [
        ("reprojection", "horizontal"),
        ("reprojection", "vertical"),
        ("tracking", "horizontal"),
        ("tracking", "vertical"),
    ]
    first, second, _ = verdicts(results)
    assert first.startswith(("Zero-mean: yes; ", "Zero-mean: nearly; "))
    assert second.startswith("Variance grows with blur: yes;")
    for pair in (results[:2], results[2:]):
        low = sum(finding.low.sigma_px**2 for finding in pair)
        high = sum(finding.high.sigma_px**2 for finding in pair)
        assert high > 2.0 * low


def test_a_claim_that_fails_is_called_failed(observations: BlurObservations) -> None:
    """A large offset is no zero mean; with high and low blur swapped, no variance grows."""
    shifted = replace(
        observations, tracking_px=observations.tracking_px + 20.0, blur=1.0 - observations.blur
    )
    first, second, _ = verdicts(findings(shifted, np.random.default_rng(0)))
    assert first.startswith("Zero-mean: no; ")
    assert second.startswith("Variance grows with blur: not for all;")


def test_the_same_seed_gives_the_same_views(views: list[BlurView]) -> None:
    for again, view in zip(islice(blur_views(INSTANTS, SEED), 2), views, strict=False):
        np.testing.assert_array_equal(again.left, view.left)
        np.testing.assert_array_equal(again.reprojection_px, view.reprojection_px)
        np.testing.assert_array_equal(again.tracking_px, view.tracking_px)


def test_failed_detections_are_counted_and_leave_no_errors(views: list[BlurView]) -> None:
    unknown = np.full((NUM_CORNERS, 2), np.nan)
    blind = replace(views[0], left_px=None, blur=None, reprojection_px=unknown, tracking_px=unknown)
    no_fast = replace(views[1], fast_found=False, reprojection_px=unknown)
    chosen = [blind, no_fast, *views[2:]]
    fewer = BlurObservations.of(chosen)
    assert len(fewer) == NUM_CORNERS * (INSTANTS - 1)
    assert counts_text(chosen, fewer).startswith(
        f"Board not found in 1 left, 0 right, 1 fast images of {INSTANTS} each; "
    )
    results = findings(fewer, np.random.default_rng(0))
    assert results[0].low.count + results[0].high.count == NUM_CORNERS * (INSTANTS - 2)
    assert (
        results[2].low.count + results[2].high.count == np.isfinite(fewer.tracking_px[:, 0]).sum()
    )


def test_the_file_holds_every_observation_exactly(
    observations: BlurObservations, tmp_path: Path
) -> None:
    write_csv(tmp_path / "blur.csv", observations)
    assert (tmp_path / "blur.csv").read_text().splitlines()[0] == CSV_HEAD
    numbers = np.loadtxt(tmp_path / "blur.csv", delimiter=",", skiprows=1)
    np.testing.assert_array_equal(numbers[:, 1], observations.instant)
    np.testing.assert_array_equal(numbers[:, 3], observations.blur)
    np.testing.assert_array_equal(numbers[:, 4:6], observations.reprojection_px)
    np.testing.assert_array_equal(numbers[:, 6:], observations.tracking_px)


def test_the_page_stands_alone_and_is_the_same_each_time(
    views: list[BlurView],
    observations: BlurObservations,
    results: tuple[Finding, ...],
    tmp_path: Path,
) -> None:
    for name in ("one.html", "two.html"):
        write_blur_page(tmp_path / name, views, observations, results=results, seed=SEED)
    page = (tmp_path / "one.html").read_text()
    assert page == (tmp_path / "two.html").read_text()
    balance = Balance()
    balance.feed(page)
    assert balance.open == []
    assert len(balance.ids) == len(set(balance.ids))
    assert all(link.startswith(("#", "data:")) for link in balance.links)
    assert page.count("data:image/png") == 2
    assert page.count("<svg") == 2
