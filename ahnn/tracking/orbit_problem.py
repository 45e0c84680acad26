"""Construction of an orbit determination problem from a setup and its files."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.arguments import nearest
from ahnn.data.files import epochs
from ahnn.data.files.frames import rotations, terrestrial
from ahnn.errors import UserError
from ahnn.tracking.accelerations.acceleration_of_time import AccelerationOfTime, CubicSplines
from ahnn.tracking.earth_rotation import EarthRotation
from ahnn.tracking.formats.bulletin_b import read_bulletins
from ahnn.tracking.formats.finals import installed_orientation
from ahnn.tracking.formats.sinex import read_sinex
from ahnn.tracking.formats.tracking_files import read_tracking
from ahnn.tracking.orbit_fit import OrbitProblem
from ahnn.tracking.orbit_forces import prepared_forces
from ahnn.tracking.orbit_setup import KindChoice, OrbitSetup
from ahnn.tracking.sun_and_moon import sun_and_moon
from ahnn.tracking.tracking_data import KINDS, TrackingData
from ahnn.tracking.tracking_model import TrackingModel
from ahnn.tracking.tracking_station import TrackingStation, cartesian_station, geodetic_station
from ahnn.tracking.unknowns import START, SmoothBlock, Smoothness, Unknowns

Array = NDArray[np.float64]
TURNING = np.array([kind not in ("range", "range_rate") for kind in KINDS])
"""Mask of angles among `KINDS`."""
MARGIN = 60.0
"""Margin in seconds of Earth rotation, Sun and Moon beyond the measurements; light time is shorter."""
SMOOTH = (10.0, 0.3)
"""Initial smoothness: units of the basis, and a fraction of the time span."""


class PreparedOrbit(NamedTuple):
    """Orbit determination problem with auxiliary data.

    Attributes:
        problem: problem problem with all measurements.
        rotation: Earth rotation.
        learned: learned acceleration and index of its first unknown, or None.
    """

    problem: OrbitProblem
    rotation: EarthRotation
    learned: tuple[AccelerationOfTime, int] | None


def prepared_orbit(setup: OrbitSetup, folder: Path, data: TrackingData | None = None) -> PreparedOrbit:
    """Build the problem of a setup.

    Args:
        setup: user's setup.
        folder: base folder of file names.
        data: in place of the measurements that the setup names.

    Raises:
        UserError: an invalid file or station.
    """
    data = measured(setup, folder) if data is None else data
    at = (start_moment(setup) - data.epoch) / epochs.SECOND
    first, last = min(at, data.times[0]) - MARGIN, max(at, data.times[-1]) + MARGIN
    rows = read_bulletins([folder / name for name in setup.orientation]) if setup.orientation else None
    rotation = EarthRotation(data.epoch, first, last, rows or installed_orientation())
    bodies = sun_and_moon(data.epoch, first, last)
    forces = prepared_forces(
        setup.forces,
        setup.start.epoch[:10],
        rotation,
        bodies,
        min(at, data.times[0]),
        max(at, data.times[-1]),
    )
    model = TrackingModel(data, stations_of(setup, folder, data), setup.corrections, rotation, bodies)
    noise = noise_of(setup, data)
    require_light(setup, data)
    turn = rotations(terrestrial(data.epoch, np.array([at]), "UTC"), setup.start.frame, "GCRF")[0]
    start = np.concatenate((turn @ np.array(setup.start.position), turn @ np.array(setup.start.velocity)))
    bias, bias_sd = biases_of(setup.biases, data)
    names = (
        *START,
        *forces.forces.parameters,
        *(f"bias {data.stations[s]} {KINDS[k]}" for s, k in bias),
    )
    unknowns = Unknowns(
        names,
        np.concatenate((start, forces.mean, np.zeros(len(bias)))),
        np.concatenate((np.full(6, np.inf), forces.deviations, bias_sd)),
        len(forces.mean),
        bias,
        tuple(
            SmoothBlock(6 + place, term.basis)
            for term, place in ([forces.learned] if forces.learned else [])
            if isinstance(term.basis, CubicSplines)
        ),
    )
    smooth = Smoothness(SMOOTH[0], SMOOTH[1] * (last - first)) if unknowns.smooth else None
    problem = OrbitProblem(
        forces.forces,
        model,
        unknowns,
        noise,
        np.ones(len(data.times), dtype=bool),
        at,
        robust=setup.loss == "huber",
        noise_known=not setup.noise_estimated,
        smooth=smooth,
    )
    learned = None if forces.learned is None else (forces.learned[0], 6 + forces.learned[1])
    return PreparedOrbit(problem, rotation, learned)


def start_moment(setup: OrbitSetup) -> int:
    """Return the epoch of the start in picoseconds; raises UserError for an invalid epoch."""
    try:
        return epochs.instant(setup.start.epoch, utc=True)
    except ValueError as error:
        message = f"start.epoch: expected {error}; received {setup.start.epoch!r}"
        raise UserError(message) from error


def measured(setup: OrbitSetup, folder: Path) -> TrackingData:
    """Return the measurements of the satellite; raises UserError if the satellite is ambiguous."""
    found = read_tracking(folder / setup.measurements)
    known = [one for one in found if setup.object in (None, one.object)]
    if len(known) != 1:
        objects = ", ".join(f"{one.object or 'without a name'} ({one.event})" for one in found)
        message = (
            f"object: expected one of {setup.measurements}: {objects}; received {setup.object or 'none'}"
        )
        raise UserError(message)
    return known[0]


def stations_of(setup: OrbitSetup, folder: Path, data: TrackingData) -> tuple[TrackingStation, ...]:
    """Return the stations named in the data; raises UserError for unknown coordinates."""
    if setup.sinex is not None:
        catalogue = read_sinex(*(folder / name for name in setup.sinex))
        return tuple(cartesian_station(name, catalogue.position(name, data.epoch)) for name in data.stations)
    places = setup.stations or {}
    found = []
    for name in data.stations:
        place = places.get(name)
        listed = place if isinstance(place, list) else []
        numbers = [float(one) for one in listed if isinstance(one, int | float)]
        if len(listed) != 3 or len(numbers) != 3 or not np.isfinite(numbers).all() or abs(numbers[0]) > 90:
            known = "" if name in places else nearest(name, places)
            message = (
                f"stations.{name}: expected [latitude, longitude, height], degrees and m; received {place}"
            )
            raise UserError(message + known)
        latitude, longitude, height = numbers
        found.append(geodetic_station(name, latitude, longitude, height / 1e3))
    if unused := [name for name in places if name not in data.stations]:
        known = ", ".join(data.stations)
        message = f"stations.{unused[0]}: expected one of {setup.measurements}: {known}; received another"
        raise UserError(message)
    return tuple(found)


def by_kind(choice: KindChoice) -> Array:
    """Return the numbers of each kind in km, rad and km/s, (6,); NaN for none."""
    given = [getattr(choice, one.name) for one in sorted(fields(choice), key=lambda f: KINDS.index(f.name))]
    numbers = np.array([np.nan if one is None else one for one in given], dtype=np.float64)
    return np.where(TURNING, np.radians(numbers), numbers)


def noise_of(setup: OrbitSetup, data: TrackingData) -> Array:
    """Return the noise by station and kind, (stations, 6): from the setup, else the file's median.

    Raises:
        UserError: the noise of some measurements is unknown.
    """
    table = np.tile(by_kind(setup.noise), (len(data.stations), 1))
    for s, k in np.argwhere(np.isnan(table)):
        own = data.station == s
        if np.isfinite(data.values[own, k]).any():
            stated = data.deviations[own, k][np.isfinite(data.deviations[own, k])]
            if not len(stated):
                who = f"noise.{KINDS[k]}: expected a standard deviation of what {data.stations[s]} measured"
                message = f"{who}; received none"
                raise UserError(message)
            table[s, k] = np.median(stated)
    return table


def require_light(setup: OrbitSetup, data: TrackingData) -> None:
    """Raise UserError for laser ranges without a known wavelength if delays are corrected."""
    ranged = np.isfinite(data.values[:, 0])
    if setup.corrections.troposphere == "laser" and not np.isfinite(data.wavelength[ranged]).all():
        message = (
            "corrections.troposphere: expected radio or none for ranges without a wavelength; received laser"
        )
        raise UserError(message)


def biases_of(choice: KindChoice, data: TrackingData) -> tuple[tuple[tuple[int, int], ...], list[float]]:
    """Return the estimated biases, (station, kind), and their prior standard deviations."""
    deviations = by_kind(choice)
    pairs = [
        (s, k)
        for s in range(len(data.stations))
        for k in range(len(KINDS))
        if not np.isnan(deviations[k]) and np.isfinite(data.values[data.station == s, k]).any()
    ]
    return tuple(pairs), [float(deviations[k]) for _, k in pairs]
