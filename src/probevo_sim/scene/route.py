"""The centre line of a road: a plane curve, given by its heading over the distance along it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PPoly, make_interp_spline
from scipy.spatial import KDTree

from probevo.arrays import FloatArray
from probevo.errors import InputError

_NODE_STEP_M = 0.25
"""Four Gauss points on a cell this long integrate a radius of 1 m to 1e-13 m."""
_GAUSS = 0.5 * np.array(np.polynomial.legendre.leggauss(4)) + [[0.5], [0.0]]
"""Nodes and weights of Gauss–Legendre quadrature on the interval from 0 to 1, [2, 4]."""
_NEWTON_STEPS = 3

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Route:
    """The centre line of a road in the plane z = 0, with continuous curvature.

    ``from_turns`` and ``loop`` build it. The heading, counted from east to north, is a polynomial
    of degree 5 between knots. Its derivative is the curvature, positive to the left, and the
    integral of (cos, sin) of it is the position, so that the three agree to rounding.

    s is the distance along the line, m. An open route continues straight beyond its ends. A closed
    one repeats itself every ``length_m``, and its heading grows by 2π each time.
    """

    length_m: float
    """Length without the leads; of a closed route, the length of one lap."""
    closed: bool
    """Whether the route is a loop."""
    heading_spline: PPoly
    """Heading, rad, over s, m.

    It covers the lead before s = 0 and the lead after ``length_m``."""

    @staticmethod
    def from_turns(
        pieces: Sequence[tuple[float, float]],
        *,
        lead_m: float = 0.0,
        start_heading_rad: float = 0.0,
    ) -> Route:
        """Join straight and turning pieces one after another, from the origin on.

        Args:
            pieces: (length, m; turn, rad, positive to the left) of each. Over a piece the curvature
                rises from 0 and falls to 0 again as u² (1 − u)², with its peak at 1.875 turn /
                length.
            lead_m: length of straight road before s = 0 and after ``length_m``.
            start_heading_rad: heading at s = 0.

        Raises:
            InputError: no piece, a piece that is not longer than 0, or a negative lead.
        """
        if not pieces or min(length for length, _ in pieces) <= 0 or lead_m < 0:
            raise InputError(
                "route",
                "the pieces and the lead do not make a road.",
                "Give pieces longer than 0, a lead ≥ 0.",
            )
        # The heading over a piece is the integral of its curvature: a polynomial of u = s / length,
        # whose coefficients are scaled to polynomials of s.
        leads = [(lead_m, 0.0)] if lead_m else []
        lengths, turns = np.array([*leads, *pieces, *leads], dtype=float).T
        u_from_s = lengths ** -np.arange(5, -1, -1.0)[:, None]
        coefficients = np.array([6.0, -15.0, 10.0, 0.0, 0.0, 0.0])[:, None] * turns * u_from_s
        coefficients[-1] = start_heading_rad + np.cumsum(turns) - turns
        knots = np.r_[0.0, np.cumsum(lengths)] - lead_m
        return Route(
            float(knots[-1] - lead_m), closed=False, heading_spline=PPoly(coefficients, knots)
        )

    @staticmethod
    def loop(length_m: float, *, roundness: float = 0.0) -> Route:
        """Build a closed road that turns to the left: a winding oblong that starts eastwards.

        It starts at the origin. Its heading is 2π s / length plus waves whose period divides half
        the length. Half a loop further on the heading is larger by π, so that the second half leads
        back to where the first began.

        Args:
            length_m: length of one lap; the tightest radius is about a thirteenth of it.
            roundness: from 0, the winding oblong, to 1, a circle.

        Raises:
            InputError: the length is not positive or the roundness not within 0 … 1.
        """
        if length_m <= 0 or not 0 <= roundness <= 1:
            raise InputError("route", f"no loop has length {length_m} m and roundness {roundness}.")
        knots = np.linspace(0.0, length_m, 1 + 2 * max(60, round(length_m)))
        angle = 2.0 * np.pi / length_m * knots
        waves = (
            0.25 * np.sin(2 * angle + 0.4) - 0.2 * np.sin(4 * angle) + 0.1 * np.sin(6 * angle + 1.0)
        )
        waves[-1] = waves[0]
        spline = make_interp_spline(
            knots, (1.0 - roundness) * (waves - waves[0]), k=5, bc_type="periodic"
        )
        # The Taylor coefficients of the spline at each knot belong to the polynomial after it.
        derivatives = [spline(knots[:-1], nu=order) for order in range(6)]
        coefficients = np.array(
            [derivatives[order] / np.prod(np.arange(1, order + 1)) for order in range(5, -1, -1)]
        )

        # Add 2π s / length, which is not periodic.
        coefficients[-1] += angle[:-1]
        coefficients[-2] += 2.0 * np.pi / length_m
        return Route(length_m, closed=True, heading_spline=PPoly(coefficients, knots))

    def position(self, s_m: ArrayLike) -> FloatArray:
        """Return (x, y) at distances [...], m: [..., 2], m."""
        return _pairs(self._positions(np.asarray(s_m, float)))

    def heading(self, s_m: ArrayLike) -> FloatArray:
        """Return the direction of the tangent at distances [...], m: [...], rad, without jumps."""
        s, laps = self._inside(np.asarray(s_m, float))
        heading: FloatArray = self.heading_spline(s) + 2.0 * np.pi * laps
        return heading

    def curvature(self, s_m: ArrayLike) -> FloatArray:
        """Return the curvature at distances [...], m: [...], 1/m, positive to the left."""
        s = np.asarray(s_m, float)
        inside, _ = self._inside(s)
        curvature: FloatArray = self._curvature(inside)
        return curvature if self.closed else np.where(inside == s, curvature, 0.0)

    def place(self, s_m: ArrayLike, lateral_m: ArrayLike) -> FloatArray:
        """Return T_world_object, [..., 4, 4], m, of an object beside the road, its x along it.

        Args:
            s_m: distance along the road, [...], m, broadcast against ``lateral_m``.
            lateral_m: distance to the left of the centre line, [...], m.
        """
        s, lateral = np.broadcast_arrays(np.asarray(s_m, float), np.asarray(lateral_m, float))
        heading = self.heading(s)
        cos = np.cos(heading)
        sin = np.sin(heading)
        T_world_object = np.zeros((*s.shape, 4, 4))
        T_world_object[..., 0, 0] = T_world_object[..., 1, 1] = cos
        T_world_object[..., 1, 0] = sin
        T_world_object[..., 0, 1] = -sin
        T_world_object[..., 2, 2] = T_world_object[..., 3, 3] = 1.0
        T_world_object[..., :2, 3] = self.position(s) + lateral[..., None] * np.stack(
            [-sin, cos], axis=-1
        )
        return T_world_object

    def nearest(self, xy_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return s and the signed distance to the left, [...] each, m, of points [..., 2], m.

        A point beyond an end of an open route, nearer to that end than to the rest, belongs to the
        straight continuation there. On a closed route 0 ≤ s < ``length_m``.
        """
        # Start at the nearest node. Newton's method may leave it by at most a step, except beyond
        # an open end.
        point = np.ascontiguousarray(xy_m, dtype=float).view(complex)[..., 0]
        node = np.asarray(self._tree.query(xy_m)[1])
        s = self._nodes_m[node]
        is_end = (
            np.zeros(len(self._nodes_m))
            if self.closed
            else np.r_[1.0, np.zeros(len(self._nodes_m) - 2), 1.0]
        )
        reach_m = np.where(is_end[node] > 0, np.inf, _NODE_STEP_M)
        for _ in range(_NEWTON_STEPS):
            offset = (point - self._positions(s)) * np.exp(-1j * self.heading(s))
            # Towards the centre of curvature the slope tends to 0: there all points of the line are
            # equally near.
            slope = np.maximum(1.0 - self.curvature(s) * offset.imag, 0.05)
            s = s + np.clip(offset.real / slope, -reach_m, reach_m)
        lateral = ((point - self._positions(s)) * np.exp(-1j * self.heading(s))).imag
        return (np.mod(s, self.length_m) if self.closed else s), lateral

    @cached_property
    def _curvature(self) -> PPoly:
        return self.heading_spline.derivative()

    @cached_property
    def _nodes_m(self) -> FloatArray:
        """Places s whose positions are stored: the knots, and nodes at most a step apart."""
        knots = self.heading_spline.x
        counts = np.ceil(np.diff(knots) / _NODE_STEP_M).astype(int)
        cells = [
            np.linspace(a, b, n, endpoint=False)
            for a, b, n in zip(knots[:-1], knots[1:], counts, strict=True)
        ]
        return np.concatenate([*cells, knots[-1:]])

    @cached_property
    def _node_positions(self) -> ComplexArray:
        """Positions x + iy at the nodes; s = 0 lies in the origin."""
        nodes = self._nodes_m
        positions: ComplexArray = np.r_[0.0, np.cumsum(self._along(nodes[:-1], np.diff(nodes)))]
        positions -= positions[np.argmin(np.abs(nodes))]
        return positions

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(_pairs(self._node_positions))

    def _inside(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the place within the knots that stands for each place, and the laps in between."""
        if not self.closed:
            return np.clip(s, self.heading_spline.x[0], self.heading_spline.x[-1]), np.zeros_like(s)
        laps = np.floor(s / self.length_m)
        return s - laps * self.length_m, laps

    def _along(self, s: FloatArray, step: FloatArray) -> ComplexArray:
        """Integrate exp(iψ) over a step of at most one cell from s on, by Gauss's quadrature."""
        total = np.zeros(s.shape, complex)
        for place, weight in _GAUSS.T:
            total += weight * step * np.exp(1j * self.heading_spline(s + place * step))
        return total

    def _positions(self, s: FloatArray) -> ComplexArray:
        """Return the positions x + iy at places s, m."""
        inside, _ = self._inside(s)
        node = np.clip(
            np.searchsorted(self._nodes_m, inside, side="right") - 1, 0, len(self._nodes_m) - 2
        )
        start = self._nodes_m[node]
        position: ComplexArray = self._node_positions[node] + self._along(start, inside - start)
        if not self.closed:
            position += (s - inside) * np.exp(1j * self.heading_spline(inside))
        return position


def _pairs(z: ComplexArray) -> FloatArray:
    """Return x + iy, [...], as (x, y), [..., 2]."""
    return np.stack([z.real, z.imag], axis=-1)
