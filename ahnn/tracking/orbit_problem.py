"""Construction of an orbit determination problem from a setup and its files."""

from __future__ import annotations

import logging
from dataclasses import fields, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.arguments import nearest
from ahnn.data.files import epochs
from ahnn.data.files.frames import rotations, terrestrial
from ahnn.errors import UserError
from ahnn.measurements.station_file import StationEntry, entry_of, read_stations
from ahnn.tracking.accelerations.acceleration_of_time import AccelerationOfTime, CubicSplines
from ahnn.tracking.earth_rotation import EarthRotation
from ahnn.tracking.formats.bulletin_b import read_bulletins
from ahnn.tracking.formats.finals import installed_orientation
from ahnn.tracking.formats.sinex import read_sinex
from ahnn.tracking.formats.tracking_files import read_tracking
from ahnn.tracking.initial_orbit import initial_orbit
from ahnn.tracking.orbit_fit import OrbitProblem
from ahnn.tracking.orbit_forces import PreparedForces, prepared_forces
from ahnn.tracking.orbit_setup import KindChoice, OrbitSetup, StartChoice
from ahnn.tracking.sun_and_moon import sun_and_moon
from ahnn.tracking.tracking_data import KINDS, TrackingData
from ahnn.tracking.tracking_model import TrackingModel
from ahnn.tracking.tracking_station import TrackingStation, cartesian_station, geodetic_station
from ahnn.tracking.unknowns import START, SmoothBlock, Smoothness, Unknowns

log = logging.getLogger(__name__)

Array = NDArray[np.float64]
StationBiases = tuple[tuple[tuple[int, int], ...], list[float], list[float]]
TURNING = np.array([kind not in ("range", "range_rate") for kind in KINDS])
"""Mask of angles among `KINDS`."""
MARGIN = 60.0
"""Margin in seconds of Earth rotation, Sun and Moon beyond the measurements; light time is shorter."""
SMOOTH = (10.0, 0.3)
"""Initial smoothness: deviation in units of the basis, and length as a fraction of the time span."""


class PreparedOrbit(NamedTuple):
    """Orbit determination problem with auxiliary data.

    Attributes:
        problem: problem with all measurements.
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
        data: measurements used instead of those named by the setup.

    Raises:
        UserError: an invalid file or station.
    """
    data = measured(setup, folder) if data is None else data
    given = setup.start
    at = data.times[0] if given is None else (start_moment(given) - data.epoch) / epochs.SECOND
    first, last = min(at, data.times[0]) - MARGIN, max(at, data.times[-1]) + MARGIN
    rows = read_bulletins([folder / name for name in setup.orientation]) if setup.orientation else None
    rotation = EarthRotation(data.epoch, first, last, rows or installed_orientation())
    bodies = sun_and_moon(data.epoch, first, last)
    entries = entries_of(setup, folder, data)
    stations = stations_of(setup, folder, data, entries)
    model = TrackingModel(data, stations, setup.corrections, rotation, bodies)
    noise = noise_of(setup, data, entries)
    require_light(setup, data)
    start, at = start_of(given, at, model)
    ends = min(at, data.times[0]), max(at, data.times[-1])
    forces = prepared_forces(setup.forces, moment_of(data, at)[:10], rotation, bodies, *ends)
    unknowns = unknowns_of(start, forces, data, biases_of(setup.biases, data, entries))
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


def start_of(given: StartChoice | None, at: float, model: TrackingModel) -> tuple[Array, float]:
    """Return the given initial state, or an initial orbit, as (6,) in GCRF, km and km/s, and its time."""
    data = model.data
    if given is None:
        start, at = initial_orbit(model)
        log.info("start: an initial orbit from directions, at %s", moment_of(data, at))
        return start, at
    turn = rotations(terrestrial(data.epoch, np.array([at]), "UTC"), given.frame, "GCRF")[0]
    return np.concatenate((turn @ np.array(given.position), turn @ np.array(given.velocity))), at


def unknowns_of(start: Array, forces: PreparedForces, data: TrackingData, biases: StationBiases) -> Unknowns:
    """Return the unknowns: initial state (6,), parameters of forces, biases."""
    bias, bias_mean, bias_sd = biases
    names = (f"bias {data.stations[s]} {KINDS[k]}" for s, k in bias)
    learned = [forces.learned] if forces.learned else []
    return Unknowns(
        (*START, *forces.forces.parameters, *names),
        np.concatenate((start, forces.mean, bias_mean)),
        np.concatenate((np.full(6, np.inf), forces.deviations, bias_sd)),
        len(forces.mean),
        bias,
        tuple(SmoothBlock(6 + k, term.basis) for term, k in learned if isinstance(term.basis, CubicSplines)),
    )


def moment_of(data: TrackingData, time: float) -> str:
    """Return the epoch of a measurement time."""
    return epochs.spelled(data.epoch + round(time * epochs.SECOND), utc=True)


def start_moment(start: StartChoice) -> int:
    """Return the epoch of a start in picoseconds; raises UserError for an invalid one."""
    try:
        return epochs.instant(start.epoch, utc=True)
    except ValueError as error:
        message = f"start.epoch: expected {error}; received {start.epoch!r}"
        raise UserError(message) from error


def measured(setup: OrbitSetup, folder: Path) -> TrackingData:
    """Return the measurements of the satellite; raises UserError if the satellite is ambiguous.

    If no measurements have the name `setup.object`, it is given to measurements without a name.
    """
    found = read_tracking(folder / setup.measurements)
    known = [one for one in found if setup.object in (None, one.object)]
    if not known:
        known = [replace(one, object=setup.object or "") for one in found if not one.object]
    if len(known) != 1:
        objects = ", ".join(f"{one.object or 'without a name'} ({one.event})" for one in found)
        message = (
            f"object: expected one object in {setup.measurements} ({objects}); received "
            f"{setup.object or 'none'}"
        )
        raise UserError(message)
    return known[0]


def entries_of(setup: OrbitSetup, folder: Path, data: TrackingData) -> dict[str, StationEntry]:
    """Return the settings of each station in the data; stations from SINEX files have none.

    Raises:
        UserError: a station without settings, or one in the setup that does not occur in the data.
    """
    if setup.sinex is not None:
        return {}
    if isinstance(setup.stations, str):
        known = read_stations(folder / setup.stations)
    else:
        known = {name: entry_of(value, f"stations.{name}") for name, value in (setup.stations or {}).items()}
        if unused := [name for name in known if name not in data.stations]:
            names = ", ".join(data.stations)
            message = (
                f"stations.{unused[0]}: expected a station in {setup.measurements} ({names}); received an "
                "unknown one"
            )
            raise UserError(message)
    for name in data.stations:
        if name not in known:
            message = (
                f"stations.{name}: expected [latitude, longitude, height] in degrees and m; received None"
            )
            raise UserError(
                message + nearest(name, tuple(known), f"; known are {', '.join(known) or 'none'}")
            )
        require_event(known[name], name, data)
    return known


def require_event(entry: StationEntry, name: str, data: TrackingData) -> None:
    """Raise UserError for a station whose times tag a different event from those of the data."""
    if entry.event not in (None, data.event):
        message = f"stations: {name}.event: expected {data.event}, as measured; received {entry.event}"
        raise UserError(message)


def stations_of(
    setup: OrbitSetup, folder: Path, data: TrackingData, entries: dict[str, StationEntry]
) -> tuple[TrackingStation, ...]:
    """Return the stations in the data; raises UserError for one without coordinates."""
    if setup.sinex is not None:
        catalogue = read_sinex(*(folder / name for name in setup.sinex))
        return tuple(cartesian_station(name, catalogue.position(name, data.epoch)) for name in data.stations)
    chosen = [(name, entries[name]) for name in data.stations]
    return tuple(geodetic_station(name, e.latitude, e.longitude, e.height / 1e3) for name, e in chosen)


def by_kind(choice: KindChoice) -> Array:
    """Return the value of each kind in km, rad and km/s, (6,); NaN if not given."""
    given = [getattr(choice, one.name) for one in sorted(fields(choice), key=lambda f: KINDS.index(f.name))]
    numbers = np.array([np.nan if one is None else one for one in given], dtype=np.float64)
    return np.where(TURNING, np.radians(numbers), numbers)


def noise_of(setup: OrbitSetup, data: TrackingData, entries: dict[str, StationEntry]) -> Array:
    """Return the noise by station and kind, (stations, 6): from station, setup, or file median.

    Raises:
        UserError: the noise of some measurements is unknown.
    """
    table = np.tile(by_kind(setup.noise), (len(data.stations), 1))
    for s, name in enumerate(data.stations):
        if name in entries:
            own = np.array(entries[name].numbers("noise", np.nan))
            table[s, : len(own)] = np.where(np.isnan(own), table[s, : len(own)], own)
    for s, k in np.argwhere(np.isnan(table)):
        own = data.station == s
        if np.isfinite(data.values[own, k]).any():
            stated = data.deviations[own, k][np.isfinite(data.deviations[own, k])]
            if not len(stated):
                who = f"noise.{KINDS[k]}: expected a standard deviation for {data.stations[s]}"
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


def biases_of(choice: KindChoice, data: TrackingData, entries: dict[str, StationEntry]) -> StationBiases:
    """Return the pairs of station and kind that have biases, the known values, and standard deviations.

    A station's own values replace the common values; a known bias without deviation is not estimated.
    """
    pairs, means, deviations = list[tuple[int, int]](), list[float](), list[float]()
    for s, name in enumerate(data.stations):
        table = np.stack((np.full(len(KINDS), np.nan), by_kind(choice)))
        if name in entries:
            for row, kind in enumerate(("bias", "bias_sd")):
                own = np.array(entries[name].numbers(kind, np.nan))
                table[row, : len(own)] = np.where(np.isnan(own), table[row, : len(own)], own)
        for k in range(len(KINDS)):
            if np.isfinite(data.values[data.station == s, k]).any() and not np.isnan(table[:, k]).all():
                pairs.append((s, k))
                mean, sd = np.nan_to_num(table[:, k], nan=0.0, posinf=np.inf)
                means.append(float(mean))
                deviations.append(float(sd))
    return tuple(pairs), means, deviations
