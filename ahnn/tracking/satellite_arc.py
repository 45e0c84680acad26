"""Satellite arc with sensitivities to the initial state and to force parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import OdeSolution, solve_ivp

from ahnn.errors import TrainingError
from ahnn.tracking.accelerations import AccelerationTerm

Array = NDArray[np.float64]
PRECISION, FLOOR = 1e-11, 1e-10
"""Tolerances per step: relative, and absolute in km and km/s."""
INSIDE = 3000.0
"""Distance from the centre of the Earth in km at which an arc ends: wrong starts may fall towards it."""


@dataclass(frozen=True, eq=False)
class Forces:
    """Accelerations of a satellite, with concatenated parameters.

    Attributes:
        terms: acceleration terms.
        longest: maximum step in s, so that no shadow or spline knot is missed.
    """

    terms: Sequence[AccelerationTerm]
    longest: float = 900.0

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of all parameters."""
        return tuple(name for term in self.terms for name in term.parameters)

    def acceleration(self, t: float, state: Array, p: Array) -> tuple[Array, Array, Array]:
        """Return accelerations (..., 3), and derivatives by states (..., 3, 6) and parameters (..., 3, P).

        Args:
            t: seconds after the epoch.
            state: (..., 6).
            p: parameters, (P,) for all states or (..., P) for each state.
        """
        lead, at = state.shape[:-1], 0
        value, by_state = np.zeros((*lead, 3)), np.zeros((*lead, 3, 6))
        by_parameters = [np.empty((*lead, 3, 0))]
        for term in self.terms:
            own = p[..., at : at + len(term.parameters)]
            one = term(t, state[..., :3], state[..., 3:], own)
            at += len(term.parameters)
            value += one.value
            by_state[..., :3] += one.by_position
            by_state[..., 3:] += one.by_velocity
            if term.parameters:
                by_parameters.append(one.by_parameters)
        return value, by_state, np.concatenate(by_parameters, axis=-1)


@dataclass(frozen=True, eq=False)
class SatelliteArc:
    """Arc in GCRF, km and km/s, between two times.

    Attributes:
        first, last: ends of the arc, seconds after the epoch.
        before, after: states and sensitivities before and after the start.
        start: time of the start.
        evaluations: number of evaluations of the forces.
    """

    first: float
    last: float
    start: float
    before: OdeSolution | None
    after: OdeSolution | None
    evaluations: int

    def states(self, times: Array) -> Array:
        """Return the states (T, 6) at times (T,)."""
        return self._all(times)[:, 0]

    def sensitivities(self, times: Array) -> Array:
        """Return the derivatives by initial state and parameters, (T, 6, 6 + P), at times (T,)."""
        return self._all(times)[:, 1:].transpose(0, 2, 1)

    def _all(self, times: Array) -> Array:
        """Return states and derivatives, (T, 1 + 6 + P, 6)."""
        parts = [self.before, self.after]
        early = times < self.start if self.before is not None else np.zeros(len(times), dtype=bool)
        early = early if self.after is not None else np.ones(len(times), dtype=bool)
        found: list[Array | None] = [None, None]
        for k, chosen in enumerate((early, ~early)):
            solution = parts[k]
            if chosen.any() and solution is not None:
                found[k] = solution(times[chosen]).T
        size = next(part.shape[1] for part in found if part is not None)
        values = np.empty((len(times), size))
        for part, chosen in zip(found, (early, ~early), strict=True):
            if part is not None:
                values[chosen] = part
        return values.reshape(len(times), -1, 6)


class _Slope:
    """Derivatives of a state and its sensitivities; counts its evaluations and refuses more than `most`."""

    def __init__(self, forces: Forces, p: Array, most: float) -> None:
        self.forces, self.p, self.most, self.count = forces, p, most, 0

    def __call__(self, t: float, y: Array) -> Array:
        self.count += 1
        if self.count > self.most:
            message = f"orbit: the integration takes more than {self.most:.0f} evaluations of the forces"
            raise TrainingError(message)
        rows = y.reshape(-1, 6)
        value, by_state, by_parameters = self.forces.acceleration(t, rows[0], self.p)
        moved = rows[1:, :] @ by_state.T
        moved[6:] += by_parameters.T
        return np.concatenate((rows[:, 3:], np.vstack((value, moved))), axis=1).ravel()


def _fallen(t: float, y: Array) -> float:
    """Return the height in km above the sphere in which arcs end."""
    del t
    return float(np.linalg.norm(y[:3])) - INSIDE


cast(Any, _fallen).terminal = True


def satellite_arc(
    forces: Forces, start: Array, p: Array, at: float, first: float, last: float, most: float = np.inf
) -> SatelliteArc:
    """Propagate an arc from an initial state, with sensitivities.

    The method is Dormand and Prince's of order 8 with its interpolant of order 7 (Hairer, Nørsett &
    Wanner, Solving Ordinary Differential Equations I, section II.10); step control uses only the state, since
    the sensitivities depend on the same forces.

    Args:
        forces: forces on the satellite.
        start: initial state (6,) in GCRF, km and km/s.
        p: parameters of the forces, (P,).
        at: time of the initial state.
        first: beginning of the arc, at or before the start.
        last: end of the arc, at or after the start.
        most: maximum number of evaluations of the forces.

    Raises:
        TrainingError: the integration fails, for example for a satellite that falls into the Earth, or takes
            too long.
    """
    columns = 6 + len(p)
    if not np.isfinite(start).all():
        message = "orbit: expected a finite state to propagate; received one that is not"
        raise TrainingError(message)
    slope = _Slope(forces, p, most)
    begin = np.concatenate((start[None], np.eye(6), np.zeros((len(p), 6)))).ravel()
    floor = np.full(len(begin), np.inf)
    floor[:6] = FLOOR
    # The solver takes the root mean square over all variables, of which only six control the step.
    floor[:6] /= np.sqrt(1 + columns)

    def side(end: float) -> OdeSolution | None:
        if end == at:
            return None
        done = solve_ivp(
            slope,
            (at, end),
            begin,
            "DOP853",
            dense_output=True,
            rtol=PRECISION,
            atol=floor,
            max_step=forces.longest,
            events=_fallen,
        )
        if done.status != 0 or not np.isfinite(done.y[:6]).all():
            why = "the satellite is inside the Earth" if done.status == 1 else done.message
            message = f"orbit: the integration from {at:.0f} s stopped at {done.t[-1]:.0f} s: {why}"
            raise TrainingError(message)
        return done.sol

    before, after = side(first), side(last)
    return SatelliteArc(first, last, at, before, after, slope.count)
