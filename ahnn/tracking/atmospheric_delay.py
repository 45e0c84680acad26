"""Tropospheric delay of radio (Saastamoinen) and laser light (Mendes and Pavlis), and refraction."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SEA_PRESSURE, SEA_TEMPERATURE, SEA_HUMIDITY = 1013.25, 288.15, 0.5
"""Standard atmosphere: hPa, K and a fraction."""


class Air(NamedTuple):
    """Meteorological data at a station.

    Attributes:
        pressure: hPa, (T,).
        temperature: K, (T,).
        humidity: relative, 0 to 1, (T,).
    """

    pressure: Array
    temperature: Array
    humidity: Array

    @property
    def vapour(self) -> Array:
        """Water vapour pressure in hPa (Marini & Murray 1973; IERS Conventions 2010, 9.1.1)."""
        celsius = self.temperature - 273.15
        return self.humidity * 6.11 * 10 ** (7.5 * celsius / (237.3 + celsius))


def standard_air(height: float, size: int) -> Air:
    """Return the standard atmosphere at a height in km (ICAO), as `size` rows."""
    temperature = SEA_TEMPERATURE - 6.5 * height
    pressure = SEA_PRESSURE * (temperature / SEA_TEMPERATURE) ** 5.2559
    humidity = SEA_HUMIDITY * np.exp(-0.6396 * height)
    return Air(*(np.full(size, value) for value in (pressure, temperature, humidity)))


def measured_air(weather: Array, height: float) -> Air:
    """Return measured air from (T, 3) pressure, temperature and humidity; standard values for NaN."""
    standard = np.column_stack(standard_air(height, len(weather)))
    return Air(*np.where(np.isfinite(weather), weather, standard).T)


def gravity_factor(latitude: float, height: float) -> float:
    """Return 1 - 0.00266 cos 2 latitude - 0.00028 height in km, Saastamoinen's gravity factor."""
    return 1 - 0.00266 * np.cos(2 * latitude) - 0.00028 * height


def radio_delay(elevation: Array, air: Air, latitude: float, height: float) -> Array:
    """Return the one-way delay of radio waves in km.

    Zenith delay by Saastamoinen (1972) with the gravity of Davis et al. (1985), mapped by Black and Eisner
    (1984), valid from 4 degrees up.

    Args:
        elevation: rad, (T,).
        air: air at the station.
        latitude: geodetic, rad.
        height: km.
    """
    dry = 0.0022768 * air.pressure / gravity_factor(latitude, height)
    wet = 0.002277 * (1255 / air.temperature + 0.05) * air.vapour
    return 1e-3 * (dry + wet) * 1.001 / np.sqrt(0.002001 + np.sin(elevation) ** 2)


def laser_delay(elevation: Array, air: Air, wavelength: Array, latitude: float, height: float) -> Array:
    """Return the one-way delay of laser light in km (Mendes & Pavlis 2004; IERS Conventions 2010, 9.1.1).

    Args:
        elevation: rad, (T,).
        air: air at the station.
        wavelength: micrometres, (T,).
        latitude: geodetic, rad.
        height: above the ellipsoid, km.
    """
    zenith = laser_zenith_delay(air, wavelength, latitude, height)
    return 1e-3 * zenith * laser_mapping(elevation, air.temperature, latitude, height)


def laser_zenith_delay(air: Air, wavelength: Array, latitude: float, height: float) -> Array:
    """Return the zenith delay in m; arguments as in `laser_delay`."""
    wave = 1 / wavelength**2
    carbon = 1 + 0.534e-6 * (375 - 450)
    k0, k1, k2, k3 = 238.0185, 19990.975, 57.362, 579.55174
    dry = 0.01 * (k1 * (k0 + wave) / (k0 - wave) ** 2 + k3 * (k2 + wave) / (k2 - wave) ** 2) * carbon
    wet = 0.003101 * (295.235 + 3 * 2.6422 * wave - 5 * 0.032380 * wave**2 + 7 * 0.004028 * wave**3)
    gravity = gravity_factor(latitude, height)
    hydrostatic = 0.002416579 * dry * air.pressure
    return (hydrostatic + 1e-4 * (5.316 * wet - 3.759 * dry) * air.vapour) / gravity


def laser_mapping(elevation: Array, temperature: Array, latitude: float, height: float) -> Array:
    """Return the mapping function FCULa (Mendes et al. 2002), valid from 3 degrees up; rad, K and km."""
    celsius, cosine, metres = temperature - 273.15, np.cos(latitude), 1e3 * height
    rows = (
        (12100.8e-7, 1729.5e-9, 319.1e-7, -1847.8e-11),
        (30496.5e-7, 234.6e-8, -103.5e-6, -185.6e-10),
        (6877.7e-5, 197.2e-7, -345.8e-5, 106.0e-9),
    )
    a, b, c = (k0 + k1 * celsius + k2 * cosine + k3 * metres for k0, k1, k2, k3 in rows)
    sine = np.sin(elevation)
    return (1 + a / (1 + b / (1 + c))) / (sine + a / (sine + b / (sine + c)))


def radio_refractivity(air: Air) -> Array:
    """Return (n - 1) of radio waves, (T,) (ITU-R P.453: 77.6 P / T - 5.6 e / T + 375000 e / T^2, in 1e-6)."""
    e, t = air.vapour, air.temperature
    return 1e-6 * (77.6 * air.pressure / t - 5.6 * e / t + 3.75e5 * e / t**2)


def bending(elevation: Array, air: Air) -> Array:
    """Return the refraction in elevation, rad, (T,).

    The result is (n - 1) cot (E + 7.31 / (E + 4.4)), in degrees (Bennett 1982). It approaches (n - 1) cot E,
    the refraction of a flat atmosphere, at high elevation, and remains finite at the horizon.

    Args:
        elevation: geometric elevation, rad, (T,); clamped at -1 degree.
        air: air at the station.
    """
    degrees = np.maximum(np.degrees(elevation), -1.0)
    return radio_refractivity(air) / np.tan(np.radians(degrees + 7.31 / (degrees + 4.4)))


def bending_by_recommendation(elevation: Array, height: float) -> Array:
    """Return the refraction in elevation of the ITU reference atmosphere, rad, (T,).

    ITU-R P.834-9, equation 14, a fit for elevations up to 10 degrees; at higher elevations it is too low, at
    20 degrees by a third (0.01 degrees).

    Args:
        elevation: geometric elevation, rad, (T,).
        height: height of the station, km.
    """
    e = np.degrees(elevation)
    sea = 1.728 + 0.5411 * e + 0.03723 * e**2
    rise = height * (0.1815 + 0.06272 * e + 0.01138 * e**2) + height**2 * (0.01727 + 0.008288 * e)
    return np.radians(1 / (sea + rise))
