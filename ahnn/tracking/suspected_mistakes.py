"""Search for a mistake in the data that explains residuals larger than noise: the corrected data fit.

Stations, their coordinates and units of angles are corrected, and the orbit is fitted again. A rotation of
the Earth, for example from UTC given as UT1, is a further unknown of the linearised measurements (a score
test: Rao 1948); ranges, rates, azimuths and elevations rotate with the stations and do not reveal it, but
right ascensions do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ahnn.errors import TrainingError
from ahnn.tracking.earth_rotation import EarthRotation
from ahnn.tracking.formats.bulletin_b import EarthOrientation
from ahnn.tracking.orbit_fit import LinearisedOrbit, OrbitProblem, linearised, orbit_fit, rows_of
from ahnn.tracking.tracking_data import KINDS
from ahnn.tracking.tracking_model import ANGLES
from ahnn.tracking.tracking_station import TrackingStation, geodetic_station
from ahnn.tracking.unknowns import START

Array = NDArray[np.float64]
WIDE = 3.0
"""Root mean square of residuals in standard deviations above which mistakes are sought."""
EXPLAINED = 0.2
"""Maximum fraction of the root mean square that remains once a mistake is corrected."""
LOST = 1000.0
"""Root mean square of residuals in standard deviations, assumed for data that no state fits."""
ALIKE = 2.0
"""Ratio of residuals up to which the correction nearer to the initial orbit is the more likely one."""
MOST = 4
"""Maximum number of possible mistakes whose corrections are fitted."""
CERTAIN = 5.0
"""Minimum reported rotation of the Earth, in standard deviations."""
RATE = 7.292115e-5
"""Rotation rate of the Earth, rad/s."""
LARGEST = 1.0
"""Maximum of UT1 - UTC in s; a larger difference has another cause."""
TURN = 0.1
"""Rotation of the Earth in s for difference quotients."""
SAME = 1e-3
"""Difference in s below which values of UT1 - UTC agree."""
DEGREE = np.pi / 180


class Turned(NamedTuple):
    """Earth rotation with an additional angle.

    Attributes:
        rotation: original Earth rotation.
        seconds: change of UT1 in s.
    """

    rotation: EarthRotation
    seconds: float

    def matrices(self, times: Array) -> Array:
        """Return the matrices from GCRF to ITRF at times (T,), shape (T, 3, 3)."""
        angle = RATE * self.seconds
        turn = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        return turn @ self.rotation.matrices(times)


def suspected_mistakes(
    problem: OrbitProblem, point: LinearisedOrbit | None, rotation: EarthRotation
) -> list[str]:
    """Return messages about suspected mistakes; none if the residuals are noise.

    Args:
        problem: fitted problem.
        point: solution of the problem, or None.
        rotation: rotation of the Earth in the problem.
    """
    found = [] if point is None else turn_of(problem, point, rotation)
    if found or (point is not None and size_of(problem, point) < WIDE):
        return found
    if point is None:
        problem = of_the_state(problem)
        size = fitted_size(problem)
        limit = max(WIDE, EXPLAINED * (size if np.isfinite(size) else LOST))
    else:
        limit = max(WIDE / 2, EXPLAINED * size_of(problem, point))
    fits: list[tuple[float, str]] = []
    for words, other in nearest_first(problem):
        fits.append((fitted_size(other), words))
        if fits[-1][0] < WIDE:  # nothing is left to explain
            break
    limit = min(limit, ALIKE * min((size for size, _ in fits), default=0.0))
    return [words for size, words in fits if size < limit][:1]


def of_the_state(problem: OrbitProblem) -> OrbitProblem:
    """Return a problem whose unknowns are only the state: others can absorb a mistake, or diverge with it."""
    unknowns = problem.unknowns
    deviations = unknowns.deviations.copy()
    deviations[len(START) :] = 0.0
    return replace(problem, unknowns=replace(unknowns, deviations=deviations, smooth=()), smooth=None)


def fitted_size(problem: OrbitProblem) -> float:
    """Return the root mean square of the residuals of a fit by least squares; inf if it fails."""
    try:
        fit = orbit_fit(replace(problem, robust=False, noise_known=True))
    except (TrainingError, np.linalg.LinAlgError):
        return np.inf
    return size_of(problem, fit.point)


def size_of(problem: OrbitProblem, point: LinearisedOrbit) -> float:
    """Return the root mean square of fitted residuals in units of the given standard deviations."""
    return float(np.sqrt(np.mean(rows_of(problem, point, problem.noise).e ** 2)))


def nearest_first(problem: OrbitProblem) -> list[tuple[str, OrbitProblem]]:
    """Return the mistakes whose correction brings measurements closest to the initial orbit, best first.

    Other corrections are not fitted, since their paths diverge.
    """

    def distance(other: OrbitProblem) -> float:
        e = rows_of(other, held_against(other, begin), problem.noise).e
        return float(np.log1p(np.abs(e)).mean())

    begin = linearised(problem, problem.unknowns.mean.copy())
    ranked = [(distance(other), words, other) for words, other in undone(problem)]
    nearer = sorted((one for one in ranked if one[0] < distance(problem)), key=lambda one: one[0])
    return [(words, other) for _, words, other in nearer[:MOST]]


def held_against(problem: OrbitProblem, point: LinearisedOrbit) -> LinearisedOrbit:
    """Return a point on the same path, with the residuals for the measurements and stations of a problem."""
    residuals = problem.model.data.values - problem.model(point.arc).values
    residuals[:, ANGLES] = (residuals[:, ANGLES] + np.pi) % (2 * np.pi) - np.pi
    return point._replace(residuals=residuals)


def undone(problem: OrbitProblem) -> Iterator[tuple[str, OrbitProblem]]:
    """Yield problems in which one mistake is undone, each with its description."""
    model, data = problem.model, problem.model.data
    angles = np.array([kind not in ("range", "range_rate") for kind in KINDS])
    if np.isfinite(data.values[problem.used][:, angles]).any():
        for factor, words in (
            (1 / DEGREE, "radians given as degrees?"),
            (DEGREE, "degrees given as radians?"),
        ):
            values = np.where(angles, data.values * factor, data.values)
            other = model.of(model.stations, replace(data, values=values))
            yield f"angles fit if multiplied by {factor:.4g}: {words}", replace(problem, model=other)
    yield from with_other_coordinates(problem)
    for a, b in combinations(range(len(data.stations)), 2):
        places = list(model.stations)
        places[a], places[b] = places[b], places[a]
        words = (
            f"{data.stations[a]} and {data.stations[b]} fit at each other's position: they are interchanged"
        )
        yield words, replace(problem, model=model.of(tuple(places), data))
    for s, name in enumerate(data.stations):
        used = problem.used & (data.station != s)
        if len({*data.station[used].tolist()}) == len(data.stations) - 1 > 0:
            words = (
                f"{name} has a wrong position or measured another object; the other stations fit without it"
            )
            yield words, replace(problem, used=used)


def with_other_coordinates(problem: OrbitProblem) -> Iterator[tuple[str, OrbitProblem]]:
    """Yield problems with corrected coordinates of all stations, and of each of several."""
    model, data = problem.model, problem.model.data
    groups = [[s] for s in range(len(data.stations))]
    for group in [[*range(len(data.stations))], *(groups if len(groups) > 1 else [])]:
        for words, corrected in COORDINATES.items():
            places = list(model.stations)
            for s in group:
                places[s] = corrected(places[s])
            names = ", ".join(data.stations[s] for s in group)
            yield f"{names}: measurements fit {words}", replace(problem, model=model.of(tuple(places), data))


def interchanged(station: TrackingStation) -> TrackingStation:
    """Return a station with its latitude as longitude, and its longitude as latitude."""
    name, _, latitude, longitude, height = station
    return geodetic_station(name, longitude / DEGREE, latitude / DEGREE, height)


def of_the_other_side(station: TrackingStation) -> TrackingStation:
    """Return a station with the other sign of its longitude."""
    name, _, latitude, longitude, height = station
    return geodetic_station(name, latitude / DEGREE, -longitude / DEGREE, height)


COORDINATES = {
    "with latitude and longitude interchanged": interchanged,
    "with the other sign of the longitude, which counts eastwards": of_the_other_side,
}
"""Corrections of a station's coordinates by their description."""


def turn_of(problem: OrbitProblem, point: LinearisedOrbit, rotation: EarthRotation) -> list[str]:
    """Return a sentence if the measurements indicate a rotation of the Earth, else none."""
    turned = problem.model.on(cast(Any, Turned(rotation, TURN)))
    moved = (turned(point.arc).values - problem.model(point.arc).values) / TURN
    moved[:, ANGLES] = ((moved[:, ANGLES] * TURN + np.pi) % (2 * np.pi) - np.pi) / TURN
    rows = rows_of(problem, point, problem.noise)
    seen = np.isfinite(point.residuals) & problem.used[:, None]
    column = moved[seen] / rows.sd
    free = problem.unknowns.free
    precision = problem.unknowns.precision(problem.smooth)[np.ix_(free, free)]
    normal = rows.by.T @ rows.by + precision
    scale = 1 / np.sqrt(np.diagonal(normal))
    known = np.linalg.solve(normal * scale * scale[:, None], scale * (rows.by.T @ column)) * scale
    left = column - rows.by @ known
    weight = float(column @ left)
    if not weight > 0:
        return []
    seconds, before = float(left @ rows.e) / weight, float(rows.e @ rows.e)
    after = before - seconds**2 * weight
    sd = float(np.sqrt(max(after / len(rows.e), 1.0) / weight))
    if not CERTAIN * sd < abs(seconds) < LARGEST:
        return []
    return [
        f"directions fit if the Earth is rotated by {seconds:+.4f} ± {sd:.1g} s of UT1: UTC given for UT1?"
    ]


def orientation_mistake(
    used: EarthOrientation, known: EarthOrientation, rotation: EarthRotation
) -> list[str]:
    """Return a sentence if UT1 - UTC differs from the IERS value; most residuals do not reveal it.

    Args:
        used: orientation of the Earth given by the user.
        known: orientation of the Earth from the IERS.
        rotation: Earth rotation over the time span of the measurements.
    """
    day = rotation.day(0.5 * (rotation.first + rotation.last))
    if not known.mjd[0] <= day <= known.mjd[-1]:
        return []
    ours, theirs = (float(np.interp(day, one.mjd, one.ut1_utc)) for one in (used, known))
    if abs(ours - theirs) < SAME:
        return []
    words = f"UT1 - UTC is given as {ours:.4f} s, but the IERS gives {theirs:.4f} s: UTC given for UT1?"
    return [f"orientation: {words}"]
