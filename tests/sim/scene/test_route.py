"""The road's centre line: heading, position and curvature agree, and loops close."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from probevo.errors import InputError
from probevo_sim.scene.route import Route

TURNS = Route.from_turns(
    [(50.0, 0.0), (20.0, 1.5), (30.0, -0.7), (40.0, 0.0)], lead_m=30.0, start_heading_rad=0.4
)
LOOP = Route.loop(250.0)
every_route = pytest.mark.parametrize("route", [TURNS, LOOP, Route.loop(60.0, roundness=0.5)])


def along(route: Route) -> np.ndarray:
    return np.linspace(-40.0, route.length_m + 40.0, 7001)


@every_route
def test_heading_is_the_direction_of_the_tangent(route: Route) -> None:
    s = along(route)
    step = 1e-4
    tangent = (route.position(s + step) - route.position(s - step)) / (2 * step)
    heading = route.heading(s)
    np.testing.assert_allclose(
        tangent, np.stack([np.cos(heading), np.sin(heading)], axis=-1), atol=1e-8
    )


@every_route
def test_curvature_is_the_derivative_of_the_heading(route: Route) -> None:
    s = along(route)
    step = 1e-4
    numeric = (route.heading(s + step) - route.heading(s - step)) / (2 * step)
    np.testing.assert_allclose(route.curvature(s), numeric, atol=1e-8)


@every_route
def test_curvature_is_continuous(route: Route) -> None:
    """Steps of 0.02 m change it by little, joints and closure included."""
    assert np.abs(np.diff(route.curvature(along(route)))).max() < 0.002


def test_changes_of_heading_add_up() -> None:
    np.testing.assert_allclose(
        TURNS.heading([0.0, 50.0, 70.0, 100.0, 140.0]), 0.4 + np.array([0, 0, 1.5, 0.8, 0.8])
    )
    assert TURNS.length_m == pytest.approx(140.0)


def test_sharpest_curve_is_in_the_middle_of_its_piece() -> None:
    assert TURNS.curvature(60.0) == pytest.approx(1.875 * 1.5 / 20.0)


def test_straight_road_is_straight() -> None:
    np.testing.assert_allclose(
        TURNS.position([-30.0, 0.0, 50.0]), np.outer([-30, 0, 50], [np.cos(0.4), np.sin(0.4)])
    )


def test_open_road_continues_straight_beyond_its_ends() -> None:
    road = Route.from_turns([(10.0, 1.0)])
    end, beyond = road.place([10.0, 25.0], [2.0, 2.0])
    np.testing.assert_allclose(
        beyond, end @ [[1, 0, 0, 15], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], atol=1e-12
    )


@pytest.mark.parametrize("roundness", [0.0, 0.3, 1.0])
def test_loop_closes(roundness: float) -> None:
    route = Route.loop(250.0, roundness=roundness)
    s = np.linspace(0.0, 250.0, 101)
    np.testing.assert_allclose(route.position(s + 250.0), route.position(s), atol=1e-11)
    np.testing.assert_allclose(route.heading(s + 250.0), route.heading(s) + 2 * np.pi, atol=1e-12)
    np.testing.assert_allclose(route.curvature(s + 250.0), route.curvature(s), atol=1e-12)
    np.testing.assert_allclose(route.position(250.0 - 1e-9), 0.0, atol=2e-9)


def test_roundest_loop_is_a_circle() -> None:
    radius = 250.0 / (2 * np.pi)
    offset = Route.loop(250.0, roundness=1.0).position(np.linspace(0.0, 250.0, 100)) - [0.0, radius]
    np.testing.assert_allclose(np.linalg.norm(offset, axis=1), radius, rtol=1e-12)


def test_loop_does_not_cross_itself() -> None:
    """The winding one's parts that are more than 25 m apart along it are more than 20 m apart in
    the plane."""
    s = np.linspace(0.0, 250.0, 500, endpoint=False)
    apart_m = np.abs((s[:, None] - s + 125.0) % 250.0 - 125.0)
    distance = np.linalg.norm(LOOP.position(s)[:, None] - LOOP.position(s), axis=-1)
    assert distance[apart_m > 25.0].min() > 20.0


def test_objects_stand_to_the_left_and_face_along_the_road() -> None:
    T_world_object = Route.from_turns([(10.0, 0.0)], start_heading_rad=np.pi / 2).place(4.0, 3.0)
    np.testing.assert_allclose(
        T_world_object @ [0.0, 0.0, 0.0, 1.0], [-3.0, 4.0, 0.0, 1.0], atol=1e-12
    )
    np.testing.assert_allclose(
        T_world_object @ [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], atol=1e-12
    )
    np.testing.assert_allclose(
        T_world_object @ [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 1.0, 0.0], atol=1e-12
    )


@every_route
def test_nearest_is_the_inverse_of_place(route: Route) -> None:
    rng = np.random.default_rng(0)
    margin_m = 0.0 if route.closed else 60.0
    s = rng.uniform(-margin_m, route.length_m + margin_m, (100, 50))
    lateral = rng.uniform(-3.0, 3.0, (100, 50))
    s_found, lateral_found = route.nearest(route.place(s, lateral)[..., :2, 3])
    np.testing.assert_allclose(s_found, s, atol=1e-10)
    np.testing.assert_allclose(lateral_found, lateral, atol=1e-10)


@every_route
def test_nothing_of_the_road_is_nearer_than_nearest(route: Route) -> None:
    """Points up to 60 m off, centres of curvature among them, against samples of the road 0.02 m
    apart."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-60.0, 120.0, (5000, 2))
    samples = route.position(np.arange(0.0, route.length_m, 0.02))
    _, lateral = route.nearest(points)
    assert np.max(np.abs(lateral) - KDTree(samples).query(points)[0]) < 1e-6


@pytest.mark.parametrize("pieces", [[], [(10.0, 0.0), (0.0, 1.0)]])
def test_pieces_without_length_are_refused(pieces: list[tuple[float, float]]) -> None:
    with pytest.raises(InputError):
        Route.from_turns(pieces)


@pytest.mark.parametrize(("length_m", "roundness"), [(0.0, 0.5), (100.0, 1.1)])
def test_impossible_loop_is_refused(length_m: float, roundness: float) -> None:
    with pytest.raises(InputError):
        Route.loop(length_m, roundness=roundness)
