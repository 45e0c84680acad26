"""Validated setup of an orbit determination: the keys of its YAML file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from types import NoneType
from typing import Annotated, Any, Literal, TypeVar, get_args

from ahnn.arguments import Finite, Positive, Within, check_arguments, type_hints
from ahnn.errors import UserError
from ahnn.tracking.accelerations.acceleration_of_time import Axes
from ahnn.tracking.tracking_model import Corrections

T = TypeVar("T")
Vector = list[Finite]


@dataclass(frozen=True, kw_only=True)
class StartChoice:
    """Initial state of the fit.

    Attributes:
        epoch: epoch in UTC.
        position, velocity: km and km/s.
        frame: reference frame.
    """

    epoch: str
    position: Vector
    velocity: Vector
    frame: Literal["GCRF", "EME2000"] = "GCRF"


@dataclass(frozen=True, kw_only=True)
class GravityChoice:
    """Gravity field of the Earth.

    Attributes:
        field: eigen6s (to degree 12), ggm05c (to degree 8), or an ICGEM file.
        degree, order: truncation; by default the full field.
        epoch: YYYY-MM-DD epoch of time-variable coefficients; by default the epoch of the start.
    """

    field: str = "eigen6s"
    degree: Annotated[int, Within(0)] | None = None
    order: Annotated[int, Within(0)] | None = None
    epoch: str | None = None


@dataclass(frozen=True, kw_only=True)
class SurfaceForce:
    """Options common to radiation pressure and drag.

    Attributes:
        area_to_mass: m^2/kg.
        coefficient: reflection or drag coefficient.
        sd: prior standard deviation; 0 fixes the coefficient, infinity means no prior.
    """

    area_to_mass: Positive
    coefficient: Finite = 1.0
    sd: float = 0.0


@dataclass(frozen=True, kw_only=True)
class DragChoice(SurfaceForce):
    """Drag, with a model of air density.

    Attributes:
        atmosphere: exponential layers, or Harris-Priester with the diurnal bulge.
        exponent: exponent of Harris-Priester's bulge, from 2 for low inclinations to 6 for polar orbits.
    """

    atmosphere: Literal["exponential", "harris_priester"] = "exponential"
    exponent: Annotated[float, Within(2, 6)] = 4.0


@dataclass(frozen=True, kw_only=True)
class LearnedChoice:
    """Acceleration learned in addition to known forces.

    Attributes:
        kind: smooth function of time, or polynomial.
        axes: inertial, or radial, along-track and cross-track.
        pieces: number of spline pieces.
        degree: degree of the polynomial.
        unit: unit of the weights, km/s^2.
    """

    kind: Literal["smooth", "polynomial"] = "smooth"
    axes: Axes = "orbital"
    pieces: Annotated[int, Within(1, 200)] = 12
    degree: Annotated[int, Within(0, 8)] = 1
    unit: Positive = 1e-9


@dataclass(frozen=True, kw_only=True)
class ForcesChoice:
    """Forces on the satellite; see docs/tracking.md."""

    gravity: GravityChoice = field(default_factory=GravityChoice)
    sun: bool = True
    moon: bool = True
    solid_tides: bool = False
    relativity: bool = False
    radiation_pressure: SurfaceForce | None = None
    drag: DragChoice | None = None
    learned: LearnedChoice | None = None


@dataclass(frozen=True, kw_only=True)
class KindChoice:
    """One number per kind of measurement: km, degrees and km/s."""

    range: float | None = None
    azimuth: float | None = None
    elevation: float | None = None
    range_rate: float | None = None
    right_ascension: float | None = None
    declination: float | None = None


@dataclass(frozen=True, kw_only=True)
class OrbitSetup:
    """Setup of an orbit determination.

    Attributes:
        measurements: file in a format of `read_tracking`.
        object: name of the satellite; may be omitted if the file contains only one. If the file has no name,
            it is the name in the output.
        start: initial state of the fit; if omitted, computed from directions, and ranges if available.
        orientation: files of Bulletin B; if omitted, the data of astropy-iers-data.
        stations: for each station [latitude, longitude, height], degrees and m, or all keys of
            `ahnn.measurements.station_file`; or a file of stations; or
        sinex: files with coordinates and eccentricities of the stations.
        forces: forces on the satellite.
        corrections: corrections of ranges and angles.
        noise: standard deviations, km, degrees and km/s; if omitted, the median of those in the file.
        noise_estimated: whether to estimate the noise from the residuals, by kind.
        biases: prior standard deviation of a bias per station; omitted for no bias.
        loss: squares, or Huber's.
        held_out: final fraction of the measurements excluded from a second fit.
        compare: reference orbit, a CPF file.
        step: seconds between output states.
    """

    measurements: str
    start: StartChoice | None = None
    noise: KindChoice = field(default_factory=KindChoice)
    object: str | None = None
    orientation: list[str] | None = None
    stations: dict[str, Any] | str | None = None
    sinex: list[str] | None = None
    forces: ForcesChoice = field(default_factory=ForcesChoice)
    corrections: Corrections = field(default_factory=Corrections)
    noise_estimated: bool = False
    biases: KindChoice = field(default_factory=KindChoice)
    loss: Literal["squares", "huber"] = "squares"
    held_out: Annotated[float, Within(0, 0.9)] = 0.0
    compare: str | None = None
    step: Positive = 300.0


def setup_of(values: Mapping[str, Any]) -> OrbitSetup:
    """Parse a setup from plain values.

    Raises:
        UserError: a key that is unknown or missing, or a value of the wrong type, with its location.
    """
    setup = choice_of(OrbitSetup, values, "")
    for name in ("position", "velocity") if setup.start is not None else ():
        if len(given := getattr(setup.start, name)) != 3:
            message = f"start.{name}: expected three numbers in km or km/s; received {given}"
            raise UserError(message)
    for section in (setup.noise, setup.biases):
        for one in fields(section):
            if (given := getattr(section, one.name)) is not None and not given > 0:
                where = "noise" if section is setup.noise else "biases"
                message = f"{where}.{one.name}: expected a standard deviation > 0; received {given}"
                raise UserError(message)
    forces = setup.forces
    for name in ("radiation_pressure", "drag"):
        one = getattr(forces, name)
        if one is not None and (one.sd < 0 or math.isnan(one.sd)):
            expected = "0 (fixed), a standard deviation > 0 or .inf (free)"
            message = f"forces.{name}.sd: expected {expected}; received {one.sd}"
            raise UserError(message)
    if (setup.stations is None) == (setup.sinex is None):
        message = "stations: expected coordinates under `stations`, or files under `sinex`; received "
        raise UserError(message + ("neither" if setup.sinex is None else "both"))
    return setup


def choice_of(kind: type[T], values: Any, who: str) -> T:
    """Build a dataclass from plain values, with nested dataclasses from nested values.

    Raises:
        UserError: see `setup_of`.
    """
    if not isinstance(values, Mapping):
        message = f"{who}: expected a mapping of keys to values; received {values!r}"
        raise UserError(message)
    hints, made = type_hints(kind), dict(values)
    for name, value in values.items():
        inner = [one for one in (hints.get(name), *get_args(hints.get(name))) if isinstance(one, type)]
        nested = next((one for one in inner if is_dataclass(one)), None)
        if nested is not None and not (value is None and NoneType in inner):
            made[name] = choice_of(nested, value, f"{who}.{name}".removeprefix("."))
        elif value is None and "none" in get_args(hints.get(name)):
            made[name] = "none"
    check_arguments(who, kind, made)
    return kind(**made)
