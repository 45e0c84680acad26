"""Initial two-body orbit from three positions or directions, if no start is given; km and s."""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.errors import UserError
from ahnn.tracking.tracking_model import TrackingModel
from ahnn.tracking.tracking_station import EARTH_MU, RADIUS

Array = NDArray[np.float64]
APART = np.radians(5.0)
"""Angle between neighbouring positions above which Gibbs' method is better than a series in time."""
ARC, SERIES, SHORT = np.radians(60.0), np.radians(25.0), np.radians(0.2)
"""Angle from the first to the last position or direction: maximum, maximum for Gauss, minimum."""
NEAR = 1200.0
"""Maximum time in seconds from a direction to the nearest range for interpolation."""


def gibbs(positions: Array) -> Array:
    """Return the velocity (3,) at the second of three positions (3, 3) (Vallado 2013, algorithm 54)."""
    (a, b, c), (ra, rb, rc) = positions, np.linalg.norm(positions, axis=1)
    d = np.cross(a, b) + np.cross(b, c) + np.cross(c, a)
    n = ra * np.cross(b, c) + rb * np.cross(c, a) + rc * np.cross(a, b)
    s = (rb - rc) * a + (rc - ra) * b + (ra - rb) * c
    speed = np.sqrt(EARTH_MU / (np.linalg.norm(n) * np.linalg.norm(d)))
    return speed * (np.cross(d, b) / rb + s)


def herrick_gibbs(positions: Array, times: Array) -> Array:
    """Return the velocity (3,) at the second of three positions (3, 3) (Vallado 2013, algorithm 55)."""
    (a, b, c), cubes = positions, 12 * np.linalg.norm(positions, axis=1) ** 3 / EARTH_MU
    t21, t32, t31 = times[1] - times[0], times[2] - times[1], times[2] - times[0]
    first = -t32 * (1 / (t21 * t31) + 1 / cubes[0]) * a
    second = (t32 - t21) * (1 / (t21 * t32) + 1 / cubes[1]) * b
    return first + second + t21 * (1 / (t32 * t31) + 1 / cubes[2]) * c


def gauss(sites: Array, directions: Array, times: Array) -> list[Array]:
    """Return the state (6,) at the second of three directions for each solution (Curtis 2014, algorithm 5.5).

    Args:
        sites: positions of the observers, (3, 3).
        directions: unit vectors from the observers to the satellite, (3, 3).
        times: (3,).
    """
    t1, t3 = times[0] - times[1], times[2] - times[1]
    span = t3 - t1
    crosses = np.stack([np.cross(directions[j], directions[k]) for j, k in ((1, 2), (0, 2), (0, 1))])
    volume, d = directions[0] @ crosses[0], sites @ crosses.T
    far = (-d[0, 1] * t3 / span + d[1, 1] + d[2, 1] * t1 / span) / volume
    near = d[0, 1] * (t3**2 - span**2) * t3 / span + d[2, 1] * (span**2 - t1**2) * t1 / span
    near /= 6 * volume
    along, square = sites[1] @ directions[1], sites[1] @ sites[1]
    polynomial = np.zeros(9)
    polynomial[0], polynomial[2] = 1.0, -(far**2 + 2 * far * along + square)
    polynomial[5], polynomial[8] = -2 * EARTH_MU * near * (far + along), -((EARTH_MU * near) ** 2)
    roots = np.roots(polynomial)
    found = []
    for r in sorted(roots.real[(np.abs(roots.imag) < 1e-6 * np.abs(roots)) & (roots.real > 0.99 * RADIUS)]):
        pull = EARTH_MU / r**3
        ratio = (
            6 * (d[2, 0] * t1 / t3 + d[1, 0] * span / t3) * r**3
            + EARTH_MU * d[2, 0] * (span**2 - t1**2) * t1 / t3
        )
        first = (ratio / (6 * r**3 + EARTH_MU * (span**2 - t3**2)) - d[0, 0]) / volume
        ratio = (
            6 * (d[0, 2] * t3 / t1 - d[1, 2] * span / t1) * r**3
            + EARTH_MU * d[0, 2] * (span**2 - t3**2) * t3 / t1
        )
        last = (ratio / (6 * r**3 + EARTH_MU * (span**2 - t1**2)) - d[2, 2]) / volume
        slant = np.array([first, far + EARTH_MU * near / r**3, last])
        places = sites + slant[:, None] * directions
        f1, f3 = 1 - pull * t1**2 / 2, 1 - pull * t3**2 / 2
        g1, g3 = t1 - pull * t1**3 / 6, t3 - pull * t3**3 / 6
        velocity = (-f3 * places[0] + f1 * places[2]) / (f1 * g3 - f3 * g1)
        if (slant > 0).all() and velocity @ velocity < 2 * EARTH_MU / np.linalg.norm(places[1]):
            found.append(np.concatenate((places[1], velocity)))
    return found


class OrbitOfPositions(NamedTuple):
    """State (6,) at a time, and the angle of the arc of its positions."""

    state: Array
    time: float
    arc: float


def orbit_of_positions(positions: Array, times: Array) -> OrbitOfPositions | None:
    """Return an orbit through three of the positions (T, 3), chosen by `triple`; None without a choice."""
    if (chosen := triple(positions)) is None:
        return None
    at, three = times[chosen], positions[chosen]
    wide = min(angle(three[0], three[1]), angle(three[1], three[2])) > APART
    velocity = gibbs(three) if wide else herrick_gibbs(three, at)
    return OrbitOfPositions(np.concatenate((three[1], velocity)), float(at[1]), angle(three[0], three[2]))


def initial_orbit(model: TrackingModel) -> tuple[Array, float]:
    """Return a state (6,) in GCRF and its time, to start a fit of measurements.

    Ranges with directions use the method of Gibbs or of Herrick and Gibbs, directions alone that of Gauss.
    The three measurements of a station span the longest arc up to 60 degrees, or 25 for Gauss.

    Raises:
        UserError: no station has measured enough directions.
    """
    guesses = []
    for k, name in enumerate(model.data.stations):
        del name
        times, lines, ranges = sightings(model, k)
        sites = model.site(model.stations[k], times)
        ranged = np.isfinite(ranges)
        places = sites[ranged] + ranges[ranged, None] * lines[ranged]
        if (found := orbit_of_positions(places, times[ranged])) is not None:
            guesses.append((1.0, found.arc, found.state, found.time))
        if (chosen := triple(lines, SERIES)) is not None:
            for state in gauss(sites[chosen], lines[chosen], times[chosen]):
                guesses.append((0.0, angle(*lines[chosen][[0, 2]]), state, times[chosen][1]))
    if not guesses:
        message = (
            "start: expected a position and a velocity, or a station that measured three directions along an "
            "arc (azimuth and elevation, or right ascension and declination); received neither"
        )
        raise UserError(message)
    _, _, state, time = max(guesses, key=lambda one: one[:2])
    return state, float(time)


def sightings(model: TrackingModel, station: int) -> tuple[Array, Array, Array]:
    """Return times (T,), directions in GCRF, (T, 3), and ranges, (T,), measured by a station."""
    data = model.data
    rows = data.station == station
    times, values = data.times[rows], data.values[rows]
    seen = np.isfinite(values[:, 1:3]).all(1) | np.isfinite(values[:, 4:6]).all(1)
    t, found = times[seen], np.empty((int(seen.sum()), 3))
    axes = model.axes(model.stations[station], t)
    for k, one in enumerate(values[seen]):
        azimuthal = bool(np.isfinite(one[1:3]).all())
        a, e = one[1:3] if azimuthal else one[4:6]
        level = (np.sin(a), np.cos(a)) if azimuthal else (np.cos(a), np.sin(a))
        line = np.array([np.cos(e) * level[0], np.cos(e) * level[1], np.sin(e)])
        found[k] = axes[k].T @ line if azimuthal else line
    ranged = np.isfinite(values[:, 0])
    if not ranged.any():
        return t, found, np.full(len(t), np.nan)
    off = np.abs(t[:, None] - times[ranged]).min(1)
    return t, found, np.where(off <= NEAR, np.interp(t, times[ranged], values[ranged, 0]), np.nan)


def triple(vectors: Array, most: float = ARC) -> list[int] | None:
    """Return the indices of three of the vectors (T, 3) that span the largest angle below `most`, or None."""
    spread = np.unique(np.linspace(0, len(vectors) - 1, min(len(vectors), 40)).astype(int))
    wide = [(angle(vectors[i], vectors[j]), i, j) for i, j in combinations(spread.tolist(), 2) if j > i + 1]
    _, first, last = max((one for one in wide if SHORT < one[0] < most), default=(0.0, 0, 0))
    if not last:
        return None
    middle = range(first + 1, last)
    half = [abs(angle(vectors[first], vectors[k]) - angle(vectors[k], vectors[last])) for k in middle]
    return [first, middle[int(np.argmin(half))], last]


def angle(a: Array, b: Array) -> float:
    """Return the angle between two vectors (3,)."""
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
