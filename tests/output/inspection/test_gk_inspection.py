"""What the pages on PROBE-GK models show, against models whose noise is known."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from output.pages import Balance
from probevo.noise.gk.generalized_kernel import GeneralizedKernel
from probevo.noise.metric import UNDEFINED, Metric
from probevo.noise.model_io import load_model, save_model
from probevo.output.inspection.feature_pictures import _MARK, draw_features, value_shades
from probevo.output.inspection.gk import sections, summary, weighted_table
from probevo.output.inspection.gk_data import (
    CentersView,
    course_along,
    gained,
    share_out_of_domain,
    sigma_px,
    size_px,
    used_columns,
)
from probevo.output.inspection.gk_plots import centers_figures, gains_figure
from probevo.output.inspection.page import write_inspection
from probevo.output.inspection.subject import FrameView, Subject
from probevo.output.inspection.training_facts import em_table, kept_text, scale_table, signed

COLUMNS = ("x", "idle", "holey")
SEARCHES: dict[str, Any] = {
    "weights": {
        "candidates": ["holey", "x"],
        "gains": [0.3, 0.5],
        "chosen": {"x": 1.0, "idle": 0.0, "holey": 2.0},
    },
    "dof_counts": {"candidates": ["none", 30.0], "gains": [0.61, 0.58], "chosen": "none"},
    "neighbors": {"candidates": [50, 100], "gains": [0.55, 0.52], "chosen": 50},
}
TRAINING: dict[str, Any] = {
    "iterations": [
        {"log_likelihood": -1.0, "loop_error_m": 2.5},
        {"log_likelihood": 0.25, "loop_error_m": 1.5},
    ],
    "searches": SEARCHES,
    "recordings": [{"name": "<drive>", "frames": 40, "sha256": "abcdef0123456789"}],
    "settings": {"kind": "gk"},
}


@pytest.fixture(scope="module")
def view() -> CentersView:
    """σ is e^x/10 px along u and v_l a third of it; where ``holey`` is undefined, in a fifth of
    all, ten times that."""
    rng = np.random.default_rng(0)
    phi = rng.normal([0.0, 5.0, 2.0], [0.5, 2.0, 0.25], (4000, 3))
    phi[::5, 2] = np.nan
    sigma = 0.1 * np.exp(phi[:, 0]) * np.where(np.isnan(phi[:, 2]), 10.0, 1.0)
    errors = sigma[:, None] * rng.normal(size=(4000, 4)) * [1.0, 1 / 3, 1.0, 1.0]
    metric = Metric.fitted(phi, COLUMNS, (False, False, True))
    model = GeneralizedKernel(
        neighbors=100,
        prior_counts=4.0,
        dof_counts=1.0,
        bias_counts=math.inf,
        weights=np.array([1.0, 0.0, 2.0]),
        centers=1500,
        training=TRAINING,
    ).fit(phi, errors, metric=metric)
    return CentersView.of("m.safetensors", model, {"x": "focal lengths", "holey": "px"})


def frame_of(view: CentersView, phi: list[list[float]]) -> FrameView:
    """Features with these predictors."""
    places = np.array(phi)
    uv = np.random.default_rng(1).uniform([0, 0], [300, 100], (len(places), 2))
    columns = {"x": "focal lengths", "idle": "", "holey": "px"}
    return FrameView(
        recording="d",
        index=3,
        left=None,
        size_px=(300, 100),
        uv=uv,
        columns=columns,
        phi=places,
    )


def test_used_columns_come_in_the_order_of_their_gain(view: CentersView) -> None:
    assert [(c.name, c.weight, c.gain) for c in view.used] == [
        ("holey", 2.0, 0.3),
        ("x", 1.0, pytest.approx(0.2)),
    ]
    bare = GeneralizedKernel()
    bare.metric_ = Metric(
        COLUMNS,
        (False,) * 3,
        np.zeros(3),
        spread=np.ones(3),
        weight=np.array([0.5, 0.0, 2.0]),
        undefined_at=np.full(3, UNDEFINED),
    )
    assert [(column.name, column.gain) for column in used_columns(bare)] == [
        ("holey", None),
        ("x", None),
    ]


def test_centers_lie_where_the_samples_did(view: CentersView) -> None:
    assert view.points.shape == (1500, 2)
    holey, x = view.points.T
    assert np.isnan(holey).mean() == pytest.approx(0.2, abs=0.01)
    np.testing.assert_allclose(
        [np.nanmean(holey), np.nanstd(holey), x.mean(), x.std()], [2, 0.25, 0, 0.5], atol=0.03
    )


def test_the_noise_at_the_centers_is_that_of_the_data(view: CentersView) -> None:
    undefined = np.isnan(view.points[:, 0])
    x = view.points[:, 1]
    inner = np.abs(x) < 0.6
    dof = np.maximum(view.noise.dof, 2.5)  # at the rim, neighbours of all sizes make it small
    sigma = sigma_px(view.noise.scale) * np.sqrt(dof / (dof - 2.0))[:, None]
    factor = np.where(undefined, 10.0, 1.0)
    ratio = sigma / (0.1 * np.exp(x) * factor)[:, None]
    expected = [1.0, 1 / 3, math.sqrt(2.0)]
    for chosen in (inner & ~undefined, inner & undefined):
        np.testing.assert_allclose(np.median(ratio[chosen], axis=0), expected, rtol=0.12)
    np.testing.assert_allclose(
        size_px(np.array([np.diag([1.0, 4.0, 9.0, 16.0])])), [(1 * 2 * 3 * 4) ** 0.25], rtol=1e-12
    )


def test_a_course_is_the_quantiles_in_bins() -> None:
    column = np.linspace(0.0, 1.0, 1000)
    values = np.tile([0.0, 1.0], 500) + 10.0 * column
    column[::10] = np.nan
    course = course_along(column, values)
    assert len(course.center) == 16
    np.testing.assert_allclose(course.quantiles[1], 10.0 * course.center + 0.5, atol=0.7)
    assert (np.diff(course.center) > 0).all()
    assert course.undefined is not None
    assert course.undefined[1] == pytest.approx(np.median(values[::10]))
    assert course_along(np.ones(50), np.arange(50.0)).quantiles.shape == (3, 1)
    assert course_along(np.full(3, np.nan), np.arange(3.0)).quantiles.shape == (3, 0)


def test_the_gain_is_that_of_the_last_search() -> None:
    assert gained(SEARCHES) == 0.61
    assert gained({"weights": SEARCHES["weights"]}) == 0.5
    assert gained({}) is None
    assert gained({"weights": {"candidates": [], "gains": [], "chosen": [0.0]}}) is None
    assert (signed(0.5), signed(-0.25), signed(None)) == ("+0.500", "−0.250", "–")


def test_em_iterations_are_rows_and_the_end_error_has_a_column_where_it_is_known() -> None:
    table = em_table([*TRAINING["iterations"], {"log_likelihood": 0.5}], "the static model")
    assert table.text_rows()[1:] == [
        ("0: the static model", "-1.0000", "2.500"),
        ("1", "0.2500", "1.500"),
        ("2", "0.5000", "–"),
    ]
    without = em_table([{"log_likelihood": 0.5}], "not trained")
    assert without.text_rows()[1:] == [("0: not trained", "0.5000")]
    assert without.notes == ()


def test_the_iteration_that_was_kept_is_named_and_marked() -> None:
    iterations = [{"log_likelihood": value} for value in (0.5, 0.75, 0.7)]
    marked = em_table(iterations, "not trained", kept=1).text_rows()[1:]
    assert [name for name, _ in marked] == ["0: not trained", "1: kept", "2"]
    training: dict[str, Any] = {"iterations": iterations}
    assert kept_text(training) == ""
    training["kept_iteration"] = 2
    assert kept_text(training) == "the model after 2 iterations, the last"
    training["time_correlation_gain"] = 0.01
    assert "change the likelihood by +0.010 nats a feature, too little" in kept_text(training)
    training["kept_iteration"] = 3  # that of the last fit, which was not evaluated any more
    assert kept_text(training).startswith(
        "the model after 3 iterations, the last, which is not evaluated any more; time-correlated"
    )


def test_a_scale_matrix_is_shown_as_sigma_and_correlations() -> None:
    scale = np.diag([4.0, 1.0, 9.0, 1.0])
    scale[0, 2] = scale[2, 0] = -3.0
    rows = scale_table(scale).text_rows()[1:]
    assert [row[1] for row in rows] == [
        "2.000",
        "1.000",
        "3.000",
        "1.000",
        f"{math.sqrt(4 + 9 + 6):.3f}",
    ]
    assert rows[2][2:] == ("−0.50", "+0.00", "")


def test_rows_of_columns(view: CentersView) -> None:
    frame = frame_of(view, [[0.0, 1.0, 2.0], [1.0, 3.0, np.nan]])
    holey, x, idle = weighted_table(view, frame).text_rows()[1:]
    assert holey[:4] == ("holey", "px", "2", "+0.300")
    assert holey[-2:] == ("2.00", "50.0 %")
    assert x[-2:] == ("0.500", "–")
    assert idle[:4] == ("idle", "", "–", "–")
    without_frame = weighted_table(view, None).text_rows()[1:]
    assert [row[-2] for row in without_frame] == ["–"] * 3
    assert without_frame[0][-1] == f"{100 * np.isnan(view.points[:, 0]).mean():.1f} %"
    assert without_frame[2][-1] == "–"  # the file does not say


def test_the_page_says_what_share_is_out_of_domain_and_names_what_is_used(
    view: CentersView, tmp_path: Path
) -> None:
    frame = frame_of(
        view, [[0.1, 1.0, 2.0], [-0.3, 3.0, np.nan], [0.2, 3.0, 2.1], [40.0, 0.0, 2.0]]
    )
    assert share_out_of_domain(view.model.predict(frame.phi)) == 0.25
    subject = Subject(view.name, view.model, frame, view.units)
    pictures = write_inspection(tmp_path / "a", subject).pictures
    assert list(pictures) == ["sigma", "dof", "holey", "x"]
    assert pictures["holey"][0] == "holey: undefined for 1 of 4"
    write_inspection(tmp_path / "b", subject)
    html = (tmp_path / "a" / "inspection.html").read_text()
    assert html == (tmp_path / "b" / "inspection.html").read_text()
    page = Balance()
    page.feed(html)
    assert page.open == []
    assert len(set(page.ids)) == len(page.ids)
    titles = re.findall(r"<h2[^>]*>([^<]*)", html)
    assert titles == [
        "What the model learned",
        "holey",
        "x",
        "The predictors in figures",
        "In this frame",
        "Its features",
        "Predicted σ in this frame",
        "Predicted ν in this frame",
        "How it was trained",
        "EM iterations",
        "The prior",
        "Trained on",
        "How it was chosen",
        "Where the centers lie, over the most telling predictors",
    ]
    assert "25.0 % of the features are out of domain" in html
    assert "<dt>Gain over the static model</dt><dd>+0.610 nats a feature</dd>" in html
    assert "&lt;drive&gt;" in html
    assert "With all of the samples, K becomes 100." in html
    assert ">end error, m<" in html
    assert ">bias, px<" not in html  # it was held at zero


def test_a_model_without_a_history_has_a_page_too(view: CentersView, tmp_path: Path) -> None:
    """From Python, and with a single used column; out of the file, nothing else is known."""
    rng = np.random.default_rng(0)
    phi = rng.normal(size=(300, 2))
    model = GeneralizedKernel(
        neighbors=50,
        prior_counts=4.0,
        dof_counts=100.0,
        bias_counts=10.0,
        weights=np.array([0.0, 1.0]),
    ).fit(phi, rng.normal(1.0, 1.0, (300, 4)))
    save_model(model, tmp_path / "m.safetensors")
    read = load_model(tmp_path / "m.safetensors")
    assert isinstance(read, GeneralizedKernel)
    write_inspection(tmp_path, Subject("m", read))
    html = (tmp_path / "inspection.html").read_text()
    assert re.findall(r"<h2[^>]*>([^<]*)", html) == [
        "What the model learned",
        "column 1",
        "The predictors in figures",
        "How it was trained",
        "The prior",
    ]
    assert ">bias, px<" in html
    assert "<dt>Samples</dt><dd>300</dd>" in html


def test_the_summary_names_used_and_unused_predictors_and_the_gain(view: CentersView) -> None:
    found = summary(view.model)
    assert found.facts["predictors"] == "holey, x"
    assert found.facts["not used"] == "idle"
    assert found.facts["gain"].startswith("+0.610 nats a feature")
    gains, iterations = found.paragraphs
    assert [line.split()[0] for line in gains.splitlines()[2:]] == ["holey", "x"]
    assert iterations.splitlines()[2].startswith("0: the static model")


def test_each_two_used_columns_have_a_figure_and_searches_leave_no_gap_above_the_last_row(
    view: CentersView,
) -> None:
    """A figure of many would shrink on a narrow screen until nobody can read it."""
    (figure,) = centers_figures(view, None)
    plot, _ = figure.axes
    assert (plot.get_xlabel(), plot.get_ylabel()) == ("holey, px", "x, focal lengths")
    four = gains_figure(SEARCHES | {"prior_counts": SEARCHES["neighbors"]})
    tops = [axes.get_position().y0 for axes in four.axes]
    assert [tops.count(top) for top in sorted(set(tops))] == [2, 2]


def test_hostile_names_are_escaped(view: CentersView) -> None:
    hostile = sections(
        Subject("<m>", view.model, frame_of(view, [[0.1, 1.0, 2.0]] * 2), {"x": "<u>"})
    )
    html = "".join(hostile.sections)
    assert "<u>" not in html
    assert "<m>" not in html
    assert "&lt;drive&gt;" in html


def test_out_of_domain_features_get_a_ring() -> None:
    import cv2

    uv = np.array([[60.0, 40.0], [200.0, 40.0]])
    values = np.array([1.0, 2.0])
    for out_of_domain in (None, np.array([False, False]), np.array([False, True])):
        jpeg = draw_features(
            None,
            (720, 80),
            uv,
            shades=value_shades("σ", "px", values, logarithmic=True),
            out_of_domain=out_of_domain,
        )
        picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)[:80].astype(float)
        marked = np.linalg.norm(picture - _MARK, axis=2) < 100
        columns = np.flatnonzero(marked.any(axis=0))
        if out_of_domain is None or not out_of_domain.any():
            assert len(columns) == 0
        else:
            assert 190 < columns.min() < columns.max() < 212


def test_logarithmic_shades_have_equal_ratios() -> None:
    values = np.array([0.01, 0.1, 1.0])
    linear = value_shades("σ", "px", values)
    ratio = value_shades("σ", "px", values, logarithmic=True)
    assert ratio.ends == linear.ends
    assert ratio.place[1] == pytest.approx(0.5, abs=0.1)
    assert linear.place[1] < 0.15
