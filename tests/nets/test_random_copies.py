"""Random copies: exact targets, half of them mirrored, the same ones each time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

jax = pytest.importorskip("jax", reason="jax is missing: pip install 'probevo[nets]'")

from nets.small_pairs import small_pairs  # noqa: E402
from probevo.geometry import so3  # noqa: E402
from probevo.nets import quaternions  # noqa: E402
from probevo.nets.flow_field import CELL_PX, CELLS, FOCAL_PX, mirrored, rotated  # noqa: E402
from probevo.nets.random_copies import (  # noqa: E402
    BATCH,
    MAX_CELLS,
    MAX_FURTHER_RAD,
    RandomCopies,
    turned_pairs,
    turned_views,
)

COUNT = 200


def test_a_pair_has_the_field_of_its_rotation() -> None:
    """The flow of a copy, turned back by its own rotation, is that of the pair, or of its mirror
    image, without rotation. About half are mirrored."""
    pair = small_pairs(1)
    q = np.asarray(quaternions.exp(jax.numpy.asarray(pair.rotations)))
    copies = RandomCopies(turned_pairs, pair.fields, q, count=COUNT, seed=0)
    still = rotated(pair.fields.astype(float), so3.exp(-pair.rotations))
    num_mirrored = 0
    angles = []
    for fields, q_copy in copies:
        phi = np.asarray(quaternions.log(jax.numpy.asarray(q_copy, "float32")), np.float64)
        back = rotated(fields.astype(float), so3.exp(-phi))
        is_mirrored = np.abs(back - mirrored(still)).max() < np.abs(back - still).max()
        np.testing.assert_allclose(back, mirrored(still) if is_mirrored else still, atol=2e-6)
        num_mirrored += is_mirrored
        plain = pair.rotations * ([1.0, -1.0, -1.0] if is_mirrored else 1.0)
        angles.append(so3.log(so3.exp(phi) @ so3.exp(-plain))[0])
    assert abs(num_mirrored - 0.5 * COUNT) < 4.0 * np.sqrt(0.25 * COUNT)
    assert np.abs(angles).max() < MAX_FURTHER_RAD + 1e-5
    # Most turn about the vertical axis.
    assert np.argmax(np.std(angles, axis=0)) == 1


def test_a_view_is_turned_with_the_sun() -> None:
    """What is seen straight ahead is seen at the sun's new place if the sun stands behind it."""
    rng = np.random.default_rng(0)
    fields = rng.normal(size=(1, 4, *CELLS)).astype(np.float32)
    found = set()
    num_mirrored = 0
    for copy, directions in RandomCopies(turned_views, fields, np.eye(3)[2:], COUNT, seed=0):
        x, y, z = directions[0]
        cells = round(x / z * FOCAL_PX / CELL_PX)
        assert y == 0.0
        np.testing.assert_allclose(np.hypot(x, z), 1.0, atol=1e-6)
        kept = slice(max(cells, 0), CELLS[1] + min(cells, 0))
        plain = np.roll(fields[0], cells, axis=-1)[..., kept]
        in_mirror = fields[0][..., ::-1] * np.array([1.0, 1.0, -1.0, 1.0])[:, None, None]
        in_mirror = np.roll(in_mirror, cells, axis=-1)[..., kept]
        is_mirrored = not np.array_equal(copy[0][..., kept], plain)
        if is_mirrored:
            np.testing.assert_array_equal(copy[0][..., kept], in_mirror)
        num_mirrored += is_mirrored
        found.add(cells)
    assert abs(num_mirrored - 0.5 * COUNT) < 4.0 * np.sqrt(0.25 * COUNT)
    assert found == set(range(-MAX_CELLS, MAX_CELLS + 1))


def test_a_mirrored_view_has_the_sun_on_the_other_side() -> None:
    """As far to the left as it was to the right, apart from the turn of both."""
    fields = np.zeros((1, 4, *CELLS), np.float32)
    fields[0, 0] = np.arange(CELLS[1])  # brighter to the right, unless it is mirrored
    ahead = np.array([[0.6, -0.64, 0.48]])
    for copy, directions in RandomCopies(turned_views, fields, ahead, count=20, seed=1):
        sign = np.sign(copy[0, 0, 0, 40] - copy[0, 0, 0, 30])
        azimuth = np.arctan2(directions[0, 0], directions[0, 2])
        turn = azimuth - sign * np.arctan2(0.6, 0.48)
        cells = np.tan(turn) * FOCAL_PX / CELL_PX
        assert abs(cells - round(cells)) < 1e-3
        assert abs(cells) < MAX_CELLS + 0.5
        assert directions[0, 1] == pytest.approx(-0.64, abs=1e-6)


def test_all_data_are_copied_as_often_and_the_same_each_time() -> None:
    pairs = small_pairs(BATCH + 3)
    rows = np.arange(len(pairs), dtype=np.float64)[:, None]

    def marked(fields: Any, targets: Any, key: Any) -> Any:
        return fields + jax.random.normal(key, (len(fields), 1, 1, 1)), targets

    copies = RandomCopies(marked, pairs.fields, rows, count=2, seed=3)
    once, again = (list(copies) for _ in range(2))
    assert [len(targets) for _, targets in once] == 2 * [BATCH, 3]
    np.testing.assert_array_equal(
        np.concatenate([targets for _, targets in once]), np.tile(rows, (2, 1))
    )
    for (fields, _), (same, _) in zip(once, again, strict=True):
        np.testing.assert_array_equal(fields, same)
    assert not np.array_equal(once[0][0], once[2][0])
