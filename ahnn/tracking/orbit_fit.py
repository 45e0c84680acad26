"""Orbit determination: initial state, coefficients, biases and learned accelerations from tracking data.

Gauss-Newton on weighted residuals and priors (Tapley, Schutz & Born, Statistical Orbit Determination, 4.3),
with steps halved until the cost decreases. The first steps use least squares with the given noise; later
steps use a robust loss, noise estimated from residuals, and the smoothness of learned accelerations by
maximum evidence.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.errors import TrainingError
from ahnn.tracking.evidence_of_smoothness import chosen_smoothness
from ahnn.tracking.residual_noise import huber_weights, noise_deviations_of, scatter_of
from ahnn.tracking.satellite_arc import Forces, SatelliteArc, satellite_arc
from ahnn.tracking.tracking_data import KINDS
from ahnn.tracking.tracking_model import ANGLES, TrackingModel
from ahnn.tracking.unknowns import Smoothness, Unknowns
from ahnn.tracking.whitened_rows import WhitenedRows

log = logging.getLogger(__name__)

Array = NDArray[np.float64]
STEPS, HALVINGS = 25, 8
WORK = 10
"""Maximum work of a trial step, relative to the last one: absurd forces would take hours to integrate."""
NEAR, FINE = 30.0, 0.03
"""Step in standard deviations below which noise and smoothness are re-estimated, and the fit may end."""
STEADY = 0.03
"""Relative change of the noise between steps below which the fit may end."""


@dataclass(frozen=True, eq=False)
class OrbitProblem:
    """Definition of an orbit determination problem.

    Attributes:
        forces: forces on the satellite.
        model: measurement model.
        unknowns: estimated quantities.
        noise: initial standard deviations by station and kind, (stations, 6), km, rad and km/s.
        used: mask of fitted measurements, (N,) bool.
        at: time of the initial state.
        robust: whether to use Huber's loss.
        noise_known: whether to keep the given noise.
        smooth: initial smoothness.
    """

    forces: Forces
    model: TrackingModel
    unknowns: Unknowns
    noise: Array
    used: NDArray[np.bool_]
    at: float
    robust: bool = True
    noise_known: bool = False
    smooth: Smoothness | None = None


class LinearisedOrbit(NamedTuple):
    """Measurements linearised about a point.

    Attributes:
        x: linearisation point, (Q,).
        arc: satellite arc.
        residuals: measured minus predicted, (N, 6); NaN where missing.
        by_unknowns: derivatives of the prediction, (N, 6, Q).
        elevation: (N,) rad.
    """

    x: Array
    arc: SatelliteArc
    residuals: Array
    by_unknowns: Array
    elevation: Array


@dataclass(frozen=True, eq=False)
class OrbitFit:
    """Result of a fit.

    Attributes:
        problem: problem solved.
        point: measurements linearised about the solution.
        covariance: covariance of the unknowns, (Q, Q); 0 for unknowns that are not estimated.
        noise: standard deviations by station and kind, (stations, 6).
        smooth: smoothness of learned accelerations.
        steps: number of steps.
        converged: whether the last step was below the tolerance.
    """

    problem: OrbitProblem
    point: LinearisedOrbit
    covariance: Array
    noise: Array
    smooth: Smoothness | None
    steps: int
    converged: bool

    @property
    def deviations(self) -> Array:
        """Standard deviations of the unknowns, (Q,)."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def predicted_deviations(self) -> Array:
        """Standard deviations of unseen measurements, from unknowns and noise, (N, 6)."""
        by = self.point.by_unknowns
        known = np.einsum("nkq,qp,nkp->nk", by, self.covariance, by)
        return np.sqrt(known + self.scatter[self.problem.model.data.station] ** 2)

    @property
    def scatter(self) -> Array:
        """Root mean squares of fitted residuals by station and kind, (stations, 6).

        They represent the noise of individual measurements; the noise of the fit is larger if errors of
        neighbouring measurements are correlated, as for angles. For fewer than ten fitted values, the values
        of all stations are used.
        """
        return scatter_of(
            self.point.residuals, self.problem.model.data.station, self.problem.used, self.noise
        )


def linearised(problem: OrbitProblem, x: Array, most: float = np.inf) -> LinearisedOrbit:
    """Return residuals and derivatives at a point (Q,).

    Raises:
        TrainingError: they are not finite, or the arc needs more than `most` evaluations of the forces.
    """
    data, unknowns = problem.model.data, problem.unknowns
    p = x[6 : 6 + unknowns.forces]
    first, last = min(problem.at, data.times[0] - 1.0), max(problem.at, data.times[-1] + 1.0)
    arc = satellite_arc(problem.forces, x[:6], p, problem.at, first, last, most)
    predicted = problem.model(arc)
    biases = unknowns.biases(x, (len(data.stations), len(KINDS)))
    residuals = data.values - predicted.values - biases[data.station]
    if bool((np.isfinite(data.values) & ~np.isfinite(residuals)).any()):
        message = "orbit: a predicted measurement is not finite. Give a closer start"
        raise TrainingError(message)
    residuals[:, ANGLES] = (residuals[:, ANGLES] + np.pi) % (2 * np.pi) - np.pi
    by = np.zeros((*residuals.shape, len(x)))
    by[:, :, : 6 + unknowns.forces] = predicted.by_state @ arc.sensitivities(predicted.bounce)
    for place, (station, kind) in enumerate(unknowns.bias, 6 + unknowns.forces):
        by[data.station == station, kind, place] = 1.0
    return LinearisedOrbit(x, arc, residuals, by, predicted.elevation)


def rows_of(problem: OrbitProblem, point: LinearisedOrbit, noise: Array) -> WhitenedRows:
    """Return the whitened fitted measurements."""
    station = problem.model.data.station
    seen = np.isfinite(point.residuals) & problem.used[:, None]
    n, kind = np.nonzero(seen)
    sd = noise[station[n], kind]
    by = point.by_unknowns[n, kind][:, problem.unknowns.free]
    return WhitenedRows(point.residuals[n, kind] / sd, by / sd[:, None], station[n] * len(KINDS) + kind, sd)


def orbit_fit(problem: OrbitProblem) -> OrbitFit:
    """Solve an orbit determination problem.

    Raises:
        TrainingError: no step decreases the cost before convergence, or an arc cannot be propagated.
    """
    noise, smooth, free = problem.noise, problem.smooth, problem.unknowns.free
    point, robust, steady, converged = linearised(problem, problem.unknowns.mean.copy()), False, False, False
    covariance, steps, halvings = np.empty((0, 0)), 0, 0
    for steps in range(1, STEPS + 1):
        rows = rows_of(problem, point, noise)
        weights = huber_weights(rows.e) if robust else np.ones_like(rows.e)
        precision = problem.unknowns.precision(smooth)[np.ix_(free, free)]
        pull = rows.by.T @ (weights * rows.e) + precision @ (problem.unknowns.mean - point.x)[free]
        covariance = scaled_inverse(rows.by.T @ (weights[:, None] * rows.by) + precision)
        step = covariance @ pull
        size = float(np.abs(step / np.sqrt(np.diagonal(covariance))).max())
        log.info("orbit: step %d, %.3g standard deviations", steps, size)
        if converged := size < FINE and steady:
            break
        point, halvings = lower(problem, point, step, noise, weights, precision, max(halvings - 1, 0))
        if size < NEAR:
            before, robust = (noise, smooth), problem.robust
            noise, smooth = refined(problem, point, covariance, noise, smooth)
            steady = smooth == before[1] and bool(np.nanmax(np.abs(noise / before[0] - 1)) < STEADY)
    full = np.zeros((len(free), len(free)))
    full[np.ix_(free, free)] = covariance
    return OrbitFit(problem, point, full, noise, smooth, steps, converged)


def refined(
    problem: OrbitProblem, point: LinearisedOrbit, covariance: Array, noise: Array, smooth: Smoothness | None
) -> tuple[Array, Smoothness | None]:
    """Estimate noise and smoothness from the residuals at a point."""
    rows = rows_of(problem, point, noise)
    weights = huber_weights(rows.e) if problem.robust else np.ones_like(rows.e)
    if not problem.noise_known:
        noise = noise_deviations_of(rows, weights, covariance, noise, robust=problem.robust)
        rows = rows_of(problem, point, noise)
    if smooth is not None:
        smooth = chosen_smoothness(problem.unknowns, rows, weights, point.x, smooth)
    return noise, smooth


def scaled_inverse(normal: Array) -> Array:
    """Return the inverse of a positive definite matrix with rows of different units."""
    scale = 1 / np.sqrt(np.diagonal(normal))
    return np.linalg.inv(normal * scale * scale[:, None]) * scale * scale[:, None]


def lower(
    problem: OrbitProblem,
    point: LinearisedOrbit,
    step: Array,
    noise: Array,
    weights: Array,
    precision: Array,
    first: int,
) -> tuple[LinearisedOrbit, int]:
    """Return the point after a step, halved at least `first` times, until the cost decreases; and how often.

    Raises:
        TrainingError: no step decreases the cost.
    """
    free, mean = problem.unknowns.free, problem.unknowns.mean

    def cost(at: LinearisedOrbit) -> float:
        e, off = rows_of(problem, at, noise).e, (at.x - mean)[free]
        return float(weights @ e**2 + off @ precision @ off)

    before = cost(point)
    for halving in range(first, HALVINGS):
        x = point.x.copy()
        x[free] += step / 2**halving
        try:
            there = linearised(problem, x, WORK * point.arc.evaluations)
        except TrainingError:  # a shorter step may stay above the ground
            continue
        if cost(there) <= before * (1 + 1e-9) + 1e-9:
            return there, halving
    message = (
        "orbit: expected a step that lowers the residuals; received none. Check the coordinates of the "
        "stations, the units and the clock, or give a closer start"
    )
    raise TrainingError(message)
