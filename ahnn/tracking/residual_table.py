"""Residual statistics and diagnoses by station."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ahnn.measurements.ground_station import Event
from ahnn.tracking.orbit_fit import OrbitFit
from ahnn.tracking.tracking_data import EVENTS, KINDS

Array = NDArray[np.float64]
SHOWN: dict[str, tuple[str, float]] = {
    "range": ("m", 1e3),
    "azimuth": ("deg", 180 / np.pi),
    "elevation": ("deg", 180 / np.pi),
    "range_rate": ("mm/s", 1e6),
    "right_ascension": ("deg", 180 / np.pi),
    "declination": ("deg", 180 / np.pi),
}
"""Display unit of each kind, and the factor from km, rad and km/s."""
CERTAIN, WIDE, ALIKE = 3.0, 2.0, 0.7
"""Thresholds: standard errors of a finding, scatter relative to the noise, correlation of neighbours."""
OPPOSITE = 0.5
"""Relative tolerance within which a bias is the negative of the given one; the orbit absorbs part of it."""
FEWEST = 5


class ResidualRow(NamedTuple):
    """Residuals of one station and kind, in km, rad or km/s.

    Attributes:
        station, kind: their names.
        number: number of measurements.
        mean, sd: moments of the residuals.
        trend: trend per second, with its standard error.
        correlation: correlation of successive residuals.
        noise: standard deviation of the noise in the fit.
        bias: estimated bias and its standard deviation; NaN if not estimated.
        given: bias known before the fit.
    """

    station: str
    kind: str
    number: int
    mean: float
    sd: float
    trend: tuple[float, float]
    correlation: float
    noise: float
    bias: tuple[float, float]
    given: float = 0.0


def residual_rows(fit: OrbitFit, used: NDArray[np.bool_]) -> list[ResidualRow]:
    """Return a row for each station and kind, for the selected measurements."""
    data, unknowns = fit.problem.model.data, fit.problem.unknowns
    biases = {
        pair: (float(fit.point.x[place]), float(fit.deviations[place]), float(unknowns.mean[place]))
        for place, pair in enumerate(unknowns.bias, 6 + unknowns.forces)
    }
    rows = []
    for s, name in enumerate(data.stations):
        for k, kind in enumerate(KINDS):
            own = used & (data.station == s) & np.isfinite(fit.point.residuals[:, k])
            if own.any():
                e, t = fit.point.residuals[own, k], data.times[own]
                numbers = float(e.mean()), float(e.std()), trend_of(t, e), correlation_of(e)
                *found, given = biases.get((s, k), (np.nan, np.nan, 0.0))
                noise = float(fit.noise[s, k])
                rows.append(ResidualRow(name, kind, len(e), *numbers, noise, (found[0], found[1]), given))
    return rows


def correlation_of(e: Array) -> float:
    """Return the correlation of neighbouring residuals; 0 for fewer than five, or if all are equal."""
    e = e - e.mean()
    return float((e[1:] @ e[:-1]) / (e @ e)) if len(e) >= FEWEST and e @ e > 0 else 0.0


def effective(count: int, correlation: float) -> float:
    """Return the effective number of independent residuals (Bartlett 1946)."""
    return max(1.0, count * (1 - max(correlation, 0.0)) / (1 + max(correlation, 0.0)))


def trend_of(t: Array, e: Array) -> tuple[float, float]:
    """Return the slope of residuals (T,) in time and its standard error; 0 and infinity if undetermined."""
    if len(e) < FEWEST or t.std() == 0:
        return 0.0, np.inf
    slope = float(((t - t.mean()) @ e) / ((t - t.mean()) @ (t - t.mean())))
    rest = e - e.mean() - slope * (t - t.mean())
    error = rest.std() / (t.std() * np.sqrt(effective(len(e), correlation_of(rest))))
    return slope, float(error)


def drifts(row: ResidualRow) -> bool:
    """Return whether the residuals have a significant trend."""
    return abs(row.trend[0]) > CERTAIN * row.trend[1]


def scatters(row: ResidualRow) -> bool:
    """Return whether the residuals are much larger than the noise."""
    return row.sd > WIDE * row.noise


def verdict(row: ResidualRow) -> str:
    """Return a diagnosis of the residuals of a row in words."""
    unit, factor = SHOWN[row.kind]
    error = row.sd / np.sqrt(effective(row.number, row.correlation))
    found = []
    if row.number >= FEWEST and abs(row.mean) > CERTAIN * error and abs(row.mean) > 0.1 * row.noise:
        way = "estimate a bias" if not row.bias[1] > 0 else "its prior is too narrow"
        found.append(f"a bias of {factor * row.mean:.3g} {unit} remains: {way}")
    whole = row.mean + np.nan_to_num(row.bias[0])
    if row.given and abs(row.given) > error and abs(whole / row.given + 1) < OPPOSITE:
        found.insert(0, f"the given bias, {factor * row.given:.3g} {unit}, has the wrong sign")
    if drifts(row):
        found.append(f"drifts by {3600 * factor * row.trend[0]:+.2g} {unit} an hour")
    if scatters(row):
        found.append(f"the scatter is {row.sd / row.noise:.1f} times the noise")
    if row.correlation > ALIKE:
        found.append(f"successive residuals correlate ({row.correlation:.2f})")
    return "; ".join(found) or "fits"


def event_lines(rows: list[ResidualRow], event: Event) -> list[str]:
    """Return a line on possible causes, forces and the event of the times, if ranges drift or scatter."""
    if not any(row.kind == "range" and (drifts(row) or scatters(row)) for row in rows):
        return []
    return [
        "ranges that drift or scatter: possible causes are a force that is missing (forces.learned estimates "
        f"one) and the light time, since the times are taken as those of {EVENTS[event]} (event: {event}). A "
        "sidecar sets event: receive, transmit, or bounce for geometric ranges at the stated times. Standard "
        "deviations of the orbit do not include this"
    ]


def table_lines(rows: list[ResidualRow]) -> list[str]:
    """Format the rows as text, with units and diagnoses."""
    kinds = [f"{row.kind}, {SHOWN[row.kind][0]}" for row in rows]
    first = max([12, *(len(row.station) + 1 for row in rows)])
    second = max([12, *(len(kind) + 1 for kind in kinds)])
    head = f"  {'station':{first}s}{'kind':{second}s}{'count':>6s}{'mean':>11s}{'sd':>11s}"
    head += f"{'bias':>13s}{'± 1 sd':>11s}  verdict"
    lines = [head]
    for row, kind in zip(rows, kinds, strict=True):
        factor = SHOWN[row.kind][1]
        bias, sd = (f"{factor * one:.6g}" if np.isfinite(one) else "" for one in row.bias)
        sd = f"{factor * row.bias[1]:.2g}" if sd else ""
        lines.append(
            f"  {row.station:{first}s}{kind:{second}s}{row.number:>6d}{factor * row.mean:>11.3g}"
            f"{factor * row.sd:>11.3g}{bias:>13s}{sd:>11s}  {verdict(row)}"
        )
    return lines


def pooled(fit: OrbitFit, used: NDArray[np.bool_]) -> dict[str, tuple[int, float]]:
    """Return count and standard deviation of the residuals of all stations by kind, km, rad or km/s."""
    found = {}
    for k, kind in enumerate(KINDS):
        e = fit.point.residuals[used, k]
        e = e[np.isfinite(e)]
        if len(e) > 1:
            found[kind] = (len(e), float(e.std(ddof=1)))
    return found


def coverage(fit: OrbitFit, unseen: NDArray[np.bool_]) -> dict[str, tuple[int, float, float]]:
    """Return count, fraction within 2 sd and root mean square of unseen measurements, by kind and for all."""
    e, sd = fit.point.residuals[unseen], fit.predicted_deviations[unseen]
    inside = np.abs(e) <= 2 * sd
    found = {}
    for k, kind in enumerate(KINDS):
        seen = np.isfinite(e[:, k])
        if seen.any():
            found[kind] = (
                int(seen.sum()),
                float(inside[seen, k].mean()),
                float(np.sqrt(np.mean(e[seen, k] ** 2))),
            )
    seen = np.isfinite(e)
    found["all"] = (int(seen.sum()), float(inside[seen].mean()), np.nan)
    return found
