"""Initial belief of a filter about the orbit at a given time and the other estimated quantities."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.errors import UserError
from ahnn.tracking.orbit_fit import OrbitFit, OrbitProblem
from ahnn.tracking.satellite_flow import SIZE
from ahnn.tracking.unknowns import Unknowns

Array = NDArray[np.float64]


class OrbitBelief(NamedTuple):
    """Normal distribution of position, velocity and the other estimated unknowns.

    Attributes:
        names: names of the F components.
        mean: (F,).
        covariance: (F, F).
        time: time of the belief, seconds after the epoch.
        noise: standard deviations by station and kind, (stations, 6).
    """

    names: tuple[str, ...]
    mean: Array
    covariance: Array
    time: float
    noise: Array


def components_of(unknowns: Unknowns) -> tuple[str, ...]:
    """Return the names of the unknowns that are estimated."""
    return tuple(name for name, free in zip(unknowns.names, unknowns.free, strict=True) if free)


def fitted_belief(fit: OrbitFit, time: float) -> OrbitBelief:
    """Return the belief of a fit at a time of its arc."""
    unknowns, at = fit.problem.unknowns, np.array([time])
    free, count = unknowns.free, SIZE + unknowns.forces
    moved = np.eye(len(free))
    moved[:SIZE, :count] = fit.point.arc.sensitivities(at)[0]
    mean = np.concatenate((fit.point.arc.states(at)[0], fit.point.x[SIZE:]))
    covariance = (moved @ fit.covariance @ moved.T)[np.ix_(free, free)]
    covariance = (covariance + covariance.T) / 2  # the product rounds differently on both sides
    return OrbitBelief(components_of(unknowns), mean[free], covariance, time, fit.noise)


def prior_belief(problem: OrbitProblem, covariance: Array) -> OrbitBelief:
    """Return the prior belief of a problem, with the covariance (6, 6) of its start.

    Raises:
        UserError: a parameter or a bias has no prior, which a filter requires.
    """
    unknowns, free = problem.unknowns, problem.unknowns.free
    learned = np.zeros(len(free), dtype=bool)
    for block in unknowns.smooth:
        learned[block.places] = True
    unknown = np.isinf(unknowns.deviations) & ~learned
    unknown[:SIZE] = False
    if unknown.any():
        name = unknowns.names[int(np.argmax(unknown))]
        message = (
            f"start: expected a finite standard deviation of {name}, since no measurements are fitted; "
            "received infinity. Set orbit.forces.NAME.sd and orbit.biases.KIND, or start=fit"
        )
        raise UserError(message)
    precision = unknowns.precision(problem.smooth)[SIZE:, SIZE:][np.ix_(free[SIZE:], free[SIZE:])]
    whole = np.zeros((int(free.sum()),) * 2)
    whole[:SIZE, :SIZE], whole[SIZE:, SIZE:] = covariance, np.linalg.inv(precision)
    return OrbitBelief(components_of(unknowns), unknowns.mean[free], whole, problem.at, problem.noise)
