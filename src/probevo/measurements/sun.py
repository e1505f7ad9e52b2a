"""The direction of the sun from time and place: the ephemeris."""

from __future__ import annotations

import math
from datetime import UTC, datetime

import numpy as np

from probevo.arrays import FloatArray
from probevo.errors import InputError


def sun_in_enu(stamp_ns: int, latitude_deg: float, longitude_deg: float) -> FloatArray:
    """Return the direction of the sun in east, north and up, [3].

    Without refraction, which lifts the sun by half a degree at the horizon, and by less than 0.1°
    from 10° on. At night the last number is negative.

    Args:
        stamp_ns: time since 1970 in UTC, ns, as stamps of recordings are.
        latitude_deg: degrees north.
        longitude_deg: degrees east.

    Raises:
        InputError: the place is not on Earth, or PyEphem, the extra ``sun``, is not installed.
    """
    if not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 360.0):
        what = f"latitude {latitude_deg} and longitude {longitude_deg} are not a place on Earth."
        raise InputError("sun_in_enu", what, "Give degrees north and degrees east.")
    try:
        import ephem
    except ImportError as error:
        cure = "Install it: pip install 'probevo[sun]'."
        raise InputError("sun_in_enu", "it needs the package ephem.", cure) from error
    observer = ephem.Observer()
    observer.lat = math.radians(latitude_deg)
    observer.lon = math.radians(longitude_deg)
    observer.pressure = 0.0  # no refraction
    observer.date = datetime.fromtimestamp(1e-9 * stamp_ns, UTC)
    sun = ephem.Sun(observer)
    azimuth = float(sun.az)
    elevation = float(sun.alt)
    level = math.cos(elevation)
    return np.array([level * math.sin(azimuth), level * math.cos(azimuth), math.sin(elevation)])
