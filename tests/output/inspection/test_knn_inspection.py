"""What the pages on PROBE models show, against models whose α is known."""

import numpy as np
from scipy.spatial.distance import cdist
from scipy.stats import spearmanr

from probevo.arrays import FloatArray
from probevo.noise.metric import Metric
from probevo.noise.probe.nearest_neighbors import NearestNeighbors
from probevo.output.inspection.common_sections import is_constant
from probevo.output.inspection.knn import sections
from probevo.output.inspection.knn_data import ModelView, neighbor_radius, rank_correlation
from probevo.output.inspection.predictors import column_summaries
from probevo.output.inspection.subject import FrameView, Subject


def fitted(places: FloatArray, log_alpha: FloatArray, neighbors: int = 5) -> NearestNeighbors:
    metric = Metric.fitted(places, ["weak", "strong", "holey"], [False, False, True])
    return NearestNeighbors(neighbors, 2.0).fit(places, np.exp(log_alpha), metric=metric)


def view() -> tuple[ModelView, FloatArray, FloatArray]:
    """ln α follows the second column, and a little the first; the third lacks every fifth value."""
    rng = np.random.default_rng(0)
    places = rng.normal([3.0, -2.0, 0.0], [2.0, 0.5, 1.0], (600, 3))
    log_alpha = 0.05 * places[:, 0] + places[:, 1] + 0.3 * rng.normal(size=600)
    places[::5, 2] = np.nan
    return ModelView.of("model", fitted(places, log_alpha), {"weak": "m"}), places, log_alpha


def test_columns_are_in_the_order_in_which_alpha_varies() -> None:
    model, _, log_alpha = view()
    assert [model.columns[m] for m in model.order] == ["strong", "weak", "holey"]
    np.testing.assert_allclose(
        np.sort(model.log_alpha), np.sort(log_alpha - log_alpha.mean()), atol=1e-5
    )
    np.testing.assert_allclose(np.isnan(model.points).mean(axis=0), [0, 0, 0.2])


def test_radius_is_the_distance_to_the_kth_nearest() -> None:
    model, places, _ = view()
    queries = np.random.default_rng(1).normal([3.0, -2.0, 0.0], [4.0, 1.0, 2.0], (100, 3))
    queries[:10, 2] = np.nan
    coordinates = model.model.metric_.coordinates
    exact = np.sort(cdist(coordinates(queries), coordinates(places)), axis=1)[:, 4]
    np.testing.assert_allclose(neighbor_radius(model.model, queries), exact, rtol=1e-3)
    assert neighbor_radius(model.model, np.array([[1e3, 1e3, 1e3]]))[0] > 10.0 * model.far_radius
    assert len(neighbor_radius(model.model, np.zeros((0, 3)))) == 0


def test_correlation_is_spearmans() -> None:
    rng = np.random.default_rng(2)
    places = rng.normal(size=(300, 3)) @ rng.normal(size=(3, 3))
    places[:, 1] = np.round(places[:, 1])  # ties
    np.testing.assert_allclose(rank_correlation(places), spearmanr(places).statistic, atol=1e-12)
    holey = np.column_stack([places[:, 0], np.exp(places[:, 0]), np.ones(300)])
    holey[::3, 1] = np.nan
    table = rank_correlation(holey)
    np.testing.assert_allclose(table[0, 1], 1.0, atol=1e-3)
    assert table[0, 2] == 0.0


def test_column_summaries_are_those_of_the_data() -> None:
    model, places, _ = view()
    training = (model.model.metric_.mean, model.model.metric_.spread)
    phi = np.array([[1.0, np.nan, np.nan], [3.0, 5.0, np.nan]])
    units = dict.fromkeys(model.columns, "px")
    weak, strong, holey = column_summaries(units, phi, training)
    assert weak.frame_mean == 2.0
    np.testing.assert_allclose(weak.training or (), (places[:, 0].mean(), places[:, 0].std()))
    assert (strong.frame_mean, strong.undefined) == (5.0, 0.5)
    assert (holey.frame_mean, holey.undefined, holey.unit) == (None, 1.0, "px")
    assert column_summaries(units, phi)[0].training is None


def test_without_a_frame_the_table_shows_the_training_data_only() -> None:
    model, _, _ = view()
    units = {"weak": "m", "strong": "", "holey": ""}
    summaries = column_summaries(units, model.points, is_of_frame=False)
    assert [(column.unit, column.frame_mean) for column in summaries] == [
        ("m", None),
        ("", None),
        ("", None),
    ]
    np.testing.assert_allclose([column.undefined for column in summaries], [0.0, 0.0, 0.2])


def test_a_frame_has_a_picture_of_its_weights_distances_and_columns() -> None:
    model, _, _ = view()
    phi = np.array([[1.0, -2.0, np.nan], [3.0, -1.0, 0.5]])
    frame = FrameView(
        recording="drive",
        index=3,
        left=None,
        size_px=(40, 40),
        uv=np.array([[10.0, 10.0], [30.0, 30.0]]),
        columns=dict.fromkeys(model.columns, "px"),
        phi=phi,
    )
    findings = sections(Subject("model", model.model, frame, {"weak": "m"}))
    assert list(findings.pictures) == ["weight", "distance", "strong", "weak", "holey"]
    assert [line.split()[0] for line in findings.text.splitlines()] == [
        "column",
        "──────",
        "weak",
        "strong",
        "holey",
    ]


def test_is_constant() -> None:
    assert is_constant(np.full(3, 0.1))
    assert not is_constant(np.array([0.1, 0.1, 0.2]))
    assert not is_constant(np.full(3, np.nan))
