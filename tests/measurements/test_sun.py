"""The ephemeris: known places of the sun, and what it refuses."""

import sys
from datetime import datetime

import numpy as np
import pytest

from probevo.errors import InputError
from probevo.measurements.sun import sun_in_enu

pytest.importorskip("ephem")


def stamp_ns(date: str) -> int:
    return int(datetime.fromisoformat(f"{date}+00:00").timestamp()) * 10**9


@pytest.mark.parametrize(
    ("date", "latitude_deg", "longitude_deg", "azimuth_deg", "elevation_deg"),
    [
        # NREL's example of its solar position algorithm (Reda and Andreas 2004, Table A5.1), whose
        # elevation is less its refraction of 0.016°.
        ("2003-10-17T19:30:30", 39.742476, -105.1786, 194.340241, 39.872046),
        # Karlsruhe, where KITTI was recorded, by that algorithm (pvlib 0.16.1, spa_python).
        ("2011-09-26T11:02:00", 49.0, 8.4, 174.852061, 39.680916),
    ],
)
def test_the_sun_is_where_the_solar_position_algorithm_has_it(
    date: str,
    latitude_deg: float,
    longitude_deg: float,
    azimuth_deg: float,
    elevation_deg: float,
) -> None:
    """Within 0.003°, its parallax included."""
    east, north, up = sun_in_enu(stamp_ns(date), latitude_deg, longitude_deg)
    assert np.rad2deg(np.arctan2(east, north)) % 360.0 == pytest.approx(azimuth_deg, abs=0.003)
    assert np.rad2deg(np.arcsin(up)) == pytest.approx(elevation_deg, abs=0.003)


def test_it_is_a_unit_vector_and_below_the_horizon_at_night() -> None:
    noon = sun_in_enu(stamp_ns("2024-06-21T12:00:00"), 51.5, 0.0)
    midnight = sun_in_enu(stamp_ns("2024-06-21T00:00:00"), 51.5, 0.0)
    assert np.linalg.norm(noon) == pytest.approx(1.0)
    assert noon[1] < 0.0 < noon[2]
    assert midnight[2] < 0.0


@pytest.mark.parametrize("place", [(91.0, 0.0), (np.nan, 0.0), (0.0, 400.0)])
def test_places_that_are_not_on_earth_are_refused(place: tuple[float, float]) -> None:
    with pytest.raises(InputError, match="not a place on Earth"):
        sun_in_enu(0, *place)


def test_without_the_package_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ephem", None)
    with pytest.raises(InputError, match=r"probevo\[sun\]"):
        sun_in_enu(0, 0.0, 0.0)
