"""Accelerations of a setup, with priors on their parameters."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ahnn.systems.gravity import GravityField, eigen6s, ggm05c, read_gfc
from ahnn.systems.gravity.ggm05c import PERMANENT_TIDE
from ahnn.tracking.accelerations import AccelerationTerm
from ahnn.tracking.accelerations.acceleration_of_time import AccelerationOfTime, CubicSplines, Powers
from ahnn.tracking.accelerations.atmospheres import HarrisPriester, exponential
from ahnn.tracking.accelerations.atmospheric_drag import AtmosphericDrag
from ahnn.tracking.accelerations.earth_gravity import EarthGravity
from ahnn.tracking.accelerations.earth_tide import EarthTide
from ahnn.tracking.accelerations.radiation_pressure import RadiationPressure
from ahnn.tracking.accelerations.relativity import SchwarzschildTerm
from ahnn.tracking.accelerations.third_body import ThirdBody
from ahnn.tracking.earth_rotation import EarthRotation
from ahnn.tracking.orbit_setup import ForcesChoice, GravityChoice, LearnedChoice
from ahnn.tracking.satellite_arc import Forces
from ahnn.tracking.sun_and_moon import MOON_MU, SUN_MU, SunAndMoon

log = logging.getLogger(__name__)

LONGEST = 900.0
"""Maximum step in s; at least two steps per spline piece."""


class PreparedForces(NamedTuple):
    """Forces with their parameters.

    Attributes:
        forces: forces on the satellite.
        mean, deviations: prior means and standard deviations of the parameters.
        learned: learned term and index of its first parameter, or None.
    """

    forces: Forces
    mean: list[float]
    deviations: list[float]
    learned: tuple[AccelerationOfTime, int] | None


def gravity_field(choice: GravityChoice, date: str, *, tides: bool) -> GravityField:
    """Load the gravity field of a choice: tide-free if tides are a separate term, else zero-tide.

    Raises:
        UserError: the file is missing, or its degree is too low.
    """
    if choice.field == "eigen6s":
        field = eigen6s()
    elif choice.field == "ggm05c":
        field = ggm05c()
    else:
        field = read_gfc(choice.field, choice.epoch or date)
    degree = field.degree if choice.degree is None else choice.degree
    field = field.cut(degree, min(field.order, degree) if choice.order is None else choice.order)
    change = {"zero_tide": 1.0, "tide_free": 0.0}.get(field.tide, 0.0) - (0.0 if tides else 1.0)
    if field.tide not in ("zero_tide", "tide_free"):
        log.warning(
            "%s: the tide system is %s; coefficients are used as given, with or without tides",
            field.name,
            field.tide.replace("_", " "),
        )
    if change and degree >= 2 and field.tide in ("zero_tide", "tide_free"):
        cosines = field.cosines.copy()
        cosines[2, 0] += change * PERMANENT_TIDE
        field = replace(field, cosines=cosines, tide="tide_free" if tides else "zero_tide")
    return field


def prepared_forces(
    choice: ForcesChoice, date: str, rotation: EarthRotation, bodies: SunAndMoon, first: float, last: float
) -> PreparedForces:
    """Build the forces of a choice.

    Args:
        choice: user's choice.
        date: start date, YYYY-MM-DD.
        rotation: Earth rotation.
        bodies: positions of Sun and Moon.
        first: start time of a learned acceleration, s.
        last: end time of a learned acceleration, s.

    Raises:
        UserError: see `gravity_field`.
    """
    field = gravity_field(choice.gravity, date, tides=choice.solid_tides)
    terms: list[AccelerationTerm] = [EarthGravity(field, rotation)]
    for wanted, mu, body in ((choice.sun, SUN_MU, bodies.sun), (choice.moon, MOON_MU, bodies.moon)):
        terms += [ThirdBody(mu, body)] if wanted else []
        terms += [EarthTide(mu, body)] if choice.solid_tides else []
    terms += [SchwarzschildTerm(field.mu)] if choice.relativity else []
    mean, deviations = list[float](), list[float]()
    if choice.radiation_pressure is not None:
        terms.append(RadiationPressure(choice.radiation_pressure.area_to_mass, bodies.sun))
    if choice.drag is not None:
        bulge = HarrisPriester(bodies.sun, choice.drag.exponent)
        air = bulge if choice.drag.atmosphere == "harris_priester" else exponential
        terms.append(AtmosphericDrag(choice.drag.area_to_mass, air))
    for one in (choice.radiation_pressure, choice.drag):
        mean += [one.coefficient] if one is not None else []
        deviations += [one.sd] if one is not None else []
    if choice.learned is None:
        return PreparedForces(Forces(terms, LONGEST), mean, deviations, None)
    learned = learned_term(choice.learned, first, last)
    place, size = len(mean), len(learned.parameters)
    mean += [0.0] * size
    deviations += [np.inf] * size
    longest = LONGEST
    if isinstance(learned.basis, CubicSplines):
        longest = min(longest, learned.basis.spacing / 2)
    return PreparedForces(Forces([*terms, learned], longest), mean, deviations, (learned, place))


def learned_term(choice: LearnedChoice, first: float, last: float) -> AccelerationOfTime:
    """Return the learned acceleration between two times."""
    if choice.kind == "smooth":
        return AccelerationOfTime(
            CubicSplines(first, last, choice.pieces, choice.unit), choice.axes, "learned"
        )
    return AccelerationOfTime(Powers(first, last - first, choice.degree, choice.unit), choice.axes, "learned")
