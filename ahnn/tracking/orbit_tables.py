"""Output of an orbit determination as tables and as an orbit ephemeris message."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ahnn.data.files import Covariance, Ephemeris, epochs
from ahnn.tracking.accelerations.acceleration_of_time import LETTERS, AccelerationOfTime
from ahnn.tracking.orbit_fit import OrbitFit
from ahnn.tracking.residual_table import SHOWN
from ahnn.tracking.tracking_data import KINDS, UNITS
from ahnn.tracking.unknowns import START

Array = NDArray[np.float64]
METRES = 1e3
FRAME = "GCRF"
"""Frame of estimated states."""
ROUNDED = 1e-9
"""Rounding error of times in s."""


def as_csv(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> bytes:
    """Format a table as the bytes of a CSV file."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(rows)
    return text.getvalue().encode()


def residuals_csv(fit: OrbitFit) -> bytes:
    """Format all residuals with their predicted standard deviation, in m, deg and mm/s."""
    data, sd = fit.problem.model.data, fit.predicted_deviations
    rows = []
    for n, k in np.argwhere(np.isfinite(fit.point.residuals)).tolist():
        unit, factor = SHOWN[KINDS[k]]
        rows.append(
            (
                epochs.spelled(data.epoch + round(float(data.times[n]) * epochs.SECOND), utc=True),
                data.stations[data.station[n]],
                KINDS[k],
                unit,
                f"{factor * fit.point.residuals[n, k]:.9g}",
                f"{factor * sd[n, k]:.6g}",
                f"{np.degrees(fit.point.elevation[n]):.3f}",
                int(fit.problem.used[n]),
            )
        )
    return as_csv(("epoch_utc", "station", "kind", "unit", "residual", "sd", "elevation_deg", "fitted"), rows)


def unknowns_csv(fit: OrbitFit) -> bytes:
    """Format all unknowns with standard deviations and units; the state also with its epoch and frame."""
    names, x, sd = fit.problem.unknowns.names, fit.point.x, fit.deviations
    state = (state_epoch(fit), FRAME)
    rows = (
        (name, repr(float(value)), f"{one:.6g}", unit, *(state if name in START else ("", "")))
        for name, value, one, unit in zip(names, x, sd, units_of(fit), strict=True)
    )
    return as_csv(("name", "value", "sd", "unit", "epoch_utc", "frame"), rows)


def units_of(fit: OrbitFit) -> list[str]:
    """Return the unit of each unknown; coefficients have 1, weights that of their basis functions."""
    found = ["km"] * 3 + ["km/s"] * 3
    for term in fit.problem.forces.terms:
        unit = f"{term.basis.unit:g} km/s²" if isinstance(term, AccelerationOfTime) else "1"
        found += [unit] * len(term.parameters)
    return found + [UNITS[KINDS[kind]] for _, kind in fit.problem.unknowns.bias]


def state_epoch(fit: OrbitFit) -> str:
    """Return the epoch of the estimated state in UTC."""
    return epochs.spelled(fit.problem.model.data.epoch + round(fit.problem.at * epochs.SECOND), utc=True)


def learned_acceleration(
    fit: OrbitFit, term: AccelerationOfTime, place: int, times: Array
) -> tuple[Array, Array, Array]:
    """Evaluate a learned acceleration at times (T,): components in its axes, covariances, norms.

    Returns:
        Components (T, 3) and covariances (T, 3, 3) in m/s^2, and the norm with its deviation, (T, 2).
    """
    basis, size = term.basis.unit * term.basis(times), term.basis.size
    weights = fit.point.x[place : place + 3 * size].reshape(3, size)
    known = fit.covariance[place : place + 3 * size, place : place + 3 * size].reshape(3, size, 3, size)
    values = METRES * basis @ weights.T
    covariances = METRES**2 * np.einsum("tk,akbl,tl->tab", basis, known, basis)
    norms = np.linalg.norm(values, axis=1)
    unit = values / np.maximum(norms, 1e-300)[:, None]
    deviations = np.sqrt(np.einsum("ta,tab,tb->t", unit, covariances, unit))
    return values, covariances, np.column_stack((norms, deviations))


def acceleration_csv(fit: OrbitFit, term: AccelerationOfTime, place: int, times: Array) -> bytes:
    """Format a learned acceleration as a table, m/s^2."""
    values, covariances, norms = learned_acceleration(fit, term, place, times)
    deviations = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    epoch, letters = fit.problem.model.data.epoch, LETTERS[term.axes]
    head = (
        "epoch_utc",
        *(f"{c}_m_s2" for c in letters),
        *(f"{c}_sd" for c in letters),
        "norm_m_s2",
        "norm_sd",
    )
    rows = (
        (
            epochs.spelled(epoch + round(float(t) * epochs.SECOND), utc=True),
            *(f"{one:.6e}" for one in numbers),
        )
        for t, numbers in zip(times, np.column_stack((values, deviations, norms)), strict=True)
    )
    return as_csv(head, rows)


def whole_seconds(fit: OrbitFit, step: float) -> tuple[int, Array]:
    """Return an epoch and the seconds after it (T,) at which an orbit is written, every `step` seconds.

    Both ends are whole seconds of UTC that enclose measurements and start, within the propagated arc; the
    last interval may be shorter.
    """
    arc, data, at = fit.point.arc, fit.problem.model.data, fit.problem.at

    def second(time: float, up: int) -> int:
        return (data.epoch + round(time * epochs.SECOND) + up * (epochs.SECOND - 1)) // epochs.SECOND

    first = max(second(min(at, data.times[0]) + ROUNDED, 0), second(arc.first - ROUNDED, 1))
    last = min(second(max(at, data.times[-1]) - ROUNDED, 1), second(arc.last + ROUNDED, 0))
    count = int(np.ceil((last - first) / step - ROUNDED))
    return first * epochs.SECOND, np.append(step * np.arange(count), float(last - first))


def orbit_ephemeris(fit: OrbitFit, step: float) -> Ephemeris:
    """Return the orbit over the arc in GCRF with covariances, every `step` seconds from a whole second."""
    arc, data, unknowns = fit.point.arc, fit.problem.model.data, fit.problem.unknowns
    start, since = whole_seconds(fit, step)
    times = since + (start - data.epoch) / epochs.SECOND
    by, known = arc.sensitivities(times), fit.covariance[: 6 + unknowns.forces, : 6 + unknowns.forces]
    matrices = by @ known @ by.transpose(0, 2, 1)
    return Ephemeris(
        object_id=data.object or "SATELLITE",
        object_name="",
        center="EARTH",
        frame=FRAME,
        time_system="UTC",
        start=start,
        times=since,
        states=arc.states(times),
        covariances=tuple(Covariance(float(t), matrix) for t, matrix in zip(since, matrices, strict=True)),
    )
