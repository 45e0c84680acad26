"""A low satellite in the air, integrated here; as a script it writes docs/orbits/low.aer."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
from earth import EPOCH, bodies
from scipy.integrate import solve_ivp
from simulated import STATIONS

from ahnn.data.files import epochs
from ahnn.systems.gravity import eigen6s
from ahnn.tracking.earth_rotation import EarthRotation
from ahnn.tracking.formats.finals import installed_orientation
from ahnn.tracking.tracking_data import TrackingData
from ahnn.tracking.tracking_model import Corrections, TrackingModel

FILE = Path(__file__).parents[2] / "docs" / "orbits" / "low.aer"
START = np.array([6810.0, 0.0, 0.0, 0.0, 4.6, 6.092])
COEFFICIENT, AREA_TO_MASS = 2.2, 0.02
HOURS = 24.0
LAYERS = ((450.0, 1.585e-12, 60.828), (400.0, 3.725e-12, 58.515), (350.0, 9.518e-12, 53.298))
"""Base in km, density there in kg/m^3 and scale height in km of the air that it meets (CIRA-72)."""


def density(height):
    base, dense, scale = next(layer for layer in LAYERS if height >= layer[0])
    return dense * np.exp((base - height) / scale)


def orbit(rotation, coefficient=COEFFICIENT):
    """Point mass, second zonal harmonic in axes of the Earth, and drag of air that turns with it."""
    field = eigen6s().cut(2, 0)
    strength = 1.5 * -(5**0.5) * float(field.cosines[2, 0]) * field.mu * field.radius**2

    def slope(t, y):
        q, v = y[:3], y[3:]
        turn, r = rotation.matrices(np.array([t]))[0], np.linalg.norm(q)
        x = turn @ q
        flat = -strength / r**5 * x * (1 - 5 * x[2] ** 2 / r**2 + np.array([0, 0, 2.0]))
        wind = v - np.cross([0.0, 0.0, 7.292115e-5], q)
        air = 1e3 * density(r - 6378.137)  # km
        drag = -0.5 * coefficient * AREA_TO_MASS * air * np.linalg.norm(wind) * wind
        return np.concatenate((v, -field.mu * q / r**3 + turn.T @ flat + drag))

    span = (-2.0, 3600 * HOURS + 2)
    back, ahead = (
        solve_ivp(slope, (0.0, end), START, "DOP853", dense_output=True, rtol=1e-11, atol=1e-10).sol
        for end in span
    )
    return SimpleNamespace(states=lambda t: np.where(t < 0, back(t), ahead(t)).T)


def lines():
    """Ranges and angles of three stations each minute that it is 5 degrees above the horizon, with noise."""
    last = 3600 * HOURS + 90000
    rotation, rng = EarthRotation(EPOCH, -last, last, installed_orientation()), np.random.default_rng(7)
    times = np.repeat(np.arange(60.0, 3600 * HOURS, 60.0), 3)
    station, nothing = np.tile(np.arange(3), len(times) // 3), np.full((len(times), 6), np.nan)
    names, light = tuple(one.name for one in STATIONS), np.full(len(times), 0.532)
    taken = TrackingData("", EPOCH, times, nothing, names, station, "receive", nothing[:, :3], light, nothing)
    seen = TrackingModel(taken, STATIONS, Corrections(), rotation, bodies())(orbit(rotation)).values
    found = []
    for n in np.flatnonzero(seen[:, 2] > np.radians(5.0)):
        when, who = epochs.spelled(EPOCH + round(times[n] * 1e12), utc=True), names[station[n]]
        far, wide, high = rng.standard_normal(3)
        found.append(f"{when} RANGE {who} {seen[n, 0] + 0.01 * far:.5f}")
        azimuth, elevation = np.degrees(seen[n, 1:3]) + 0.01 * np.array([wide, high])
        found.append(f"{when} AZ_EL {who} {azimuth:.5f} {elevation:.5f}")
    return found


if __name__ == "__main__":
    FILE.write_text("\n".join(lines()) + "\n", encoding="utf-8")
