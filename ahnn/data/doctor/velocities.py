"""Comparison of velocities with derivatives of positions: tests of units, momenta and frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ahnn.data.doctor.finding import Finding, Level
from ahnn.data.doctor.slopes import Slopes, roughness, slopes
from ahnn.data.files.content import Content
from ahnn.data.files.samples import Array, Track
from ahnn.data.files.units import LENGTH, unit

EXACT = 0.03
"""Relative difference that is tolerated."""
DOUBTS = 8.0
"""Tolerated difference, as a multiple of the uncertainties of derivatives and velocities.

Noise changes a derivative by 3.6 times its effect on the difference between five- and three-point stencils.
"""
OF_SPEED = 0.01
"""Tolerated difference relative to orbital speed: velocities of theories such as SGP4 are inexact by this
amount.
"""
UNCLEAR = 0.1
"""Relative uncertainty above which nothing is reported."""
LEAST = 8
"""Minimum number of samples for testing a trajectory individually; shorter ones are pooled."""
FACTORS = {
    1000.0: "metres given as km, milliseconds given as s, or the reverse",
    60.0: "minutes given as s, or the reverse",
    3600.0: "hours given as s, or the reverse",
    180 / np.pi: "degrees given as rad, or the reverse",
    100.0: "centimetres given as m, or the reverse",
    86400.0: "days given as s, or the reverse",
}


class VelocityComparison(NamedTuple):
    """Stated velocities, position derivatives at the same samples, and uncertainties of both, (K, n)."""

    stated: Array
    derived: Array
    doubts: Array


def velocity_findings(content: Content, tracks: list[Track], mass: float | Sequence[float]) -> list[Finding]:
    """Find wrong velocities, or wrong momenta over mass, in tracks of a file.

    Args:
        content: content of the file.
        tracks: tracks to be tested.
        mass: factor of momenta, common or per coordinate.
    """
    n = len(content.positions)
    if len(content.rates) != n:
        return []
    scale = 1 / np.asarray(mass, dtype=float) if content.momenta else np.ones(())
    pairs = [(track, compared(track, n, scale)) for track in tracks]
    long = [(track, one) for track, one in pairs if one is not None and len(one.stated) >= LEAST]
    short = [one for _, one in pairs if one is not None and len(one.stated) < LEAST]
    if short:
        pooled = VelocityComparison(*(np.concatenate(parts) for parts in zip(*short, strict=True)))
        long.append((tracks[0]._replace(rows=np.zeros(1, dtype=np.int64)), pooled))
    found = []
    for c in range(n):
        wrong = of_component(content, c, long)
        swapped = bool(wrong) and not content.momenta and interchanged(content, tracks, c)
        found += [interchange(content, c)] if swapped else wrong
    return found


def interchanged(content: Content, tracks: list[Track], c: int) -> bool:
    """Return whether, in nearly all tracks, the stated position is the change in the stated velocity."""
    n, order = len(content.positions), np.arange(2 * len(content.positions))
    order[[c, n + c]] = order[[n + c, c]]
    pairs = [compared(track._replace(values=track.values[:, order]), n, np.ones(())) for track in tracks]
    judged = [ratio for one in pairs if one is not None and (ratio := misfit(one, c)) is not None]
    return judged.count(1.0) > 0.9 * len(judged)


def interchange(content: Content, c: int) -> Finding:
    """Build the finding for a position and a velocity in each other's columns."""
    name, position = content.rates[c], content.positions[c]
    what = f"{position} is the change in {name} per {content.units.time}: the columns seem to be interchanged"
    remedy = f"Interchange the names {position} and {name} in the header"
    return Finding("fault", content.tracks[0].file, content.head, name, what, remedy)


def compared(track: Track, n: int, scale: Array) -> VelocityComparison | None:
    """Return stated and derived velocities of a track; None if it is too short.

    Args:
        track: track of positions, and of velocities or momenta.
        n: number of coordinates.
        scale: factor from momenta to velocities, () or (n,).
    """
    found: Slopes | None = slopes(track.times, track.values[:, :n], 1)
    if found is None:
        return None
    stated = scale * track.values[:, n:]
    doubts = found.doubts + roughness(track.times, stated, found.at)
    known = np.isfinite(doubts).all(1)  # where all samples of a derivative are present
    return VelocityComparison(stated[found.at][known], found.values[known], doubts[known])


def of_component(content: Content, c: int, pairs: list[tuple[Track, VelocityComparison]]) -> list[Finding]:
    """Return a finding for each track with a wrong velocity; a single one if nearly all are wrong."""
    orbit = len(content.positions) == 3 and unit(content.units.position).dimension == LENGTH
    judged = [(track, ratio) for track, one in pairs if (ratio := misfit(one, c, orbit=orbit)) is not None]
    wrong = [(track, ratio) for track, ratio in judged if ratio != 1]
    if not wrong:
        return []
    if len(wrong) > 0.9 * len(judged):
        typical = float(np.median([ratio for _, ratio in wrong]))
        return [finding(content, c, wrong[0][0].file, content.head, typical)]
    return [finding(content, c, track.file, int(track.rows[0]), ratio) for track, ratio in wrong]


def misfit(one: VelocityComparison, c: int, *, orbit: bool = False) -> float | None:
    """Return 1 for a correct velocity, else its ratio to the derivative (0 if not proportional).

    Returns None if undetermined. For orbits, differences that are small relative to the orbital speed are
    also tolerated.
    """
    exact = OF_SPEED * float(np.median(np.linalg.norm(one.derived, axis=1))) if orbit else 0.0
    stated, derived, doubts = (part[:, c] for part in one)
    if len(stated) < 2:
        return None
    size = max(np.quantile(np.abs(stated), 0.75), np.quantile(np.abs(derived), 0.75))
    doubt = float(np.median(doubts))
    if size == 0 or doubt > UNCLEAR * size:
        return None
    allowed = max(EXACT * size, DOUBTS * doubt, exact)
    if np.median(np.abs(stated - derived)) <= allowed:
        return 1.0
    ratio = weighted_median(stated, derived)
    scaled = np.median(np.abs(stated - ratio * derived))
    return ratio if scaled <= max(EXACT * np.quantile(np.abs(stated), 0.75), DOUBTS * doubt) else 0.0


def weighted_median(stated: Array, derived: Array) -> float:
    """Return the median of the ratios, weighted by the size of the derivative."""
    used = derived != 0
    if not used.any():
        return 0.0
    ratios, heavy = stated[used] / derived[used], np.abs(derived[used])
    order = np.argsort(ratios)
    total = heavy[order].cumsum()
    return float(ratios[order][np.searchsorted(total, total[-1] / 2)])


def finding(content: Content, c: int, file: str, row: int, ratio: float) -> Finding:
    """Build the finding for a ratio of velocity to position derivative."""
    name, position, per = content.rates[c], content.positions[c], content.units.time
    level: Level = "warning" if content.momenta else "fault"
    kind = f"{name} over the mass" if content.momenta else name
    if ratio == 0:
        what = f"{kind} is neither the change in {position} per {per} nor proportional to it"
        turning = len(content.positions) > 1 and unit(content.units.position).dimension == LENGTH
        remedy = (
            "Give both in one inertial frame" if turning else "Correct the order or the units of the columns"
        )
        return Finding(level, file, row, name, what, remedy)
    what = f"{kind} is {ratio:.4g} times the change in {position} per {per}"
    size = abs(ratio) if abs(ratio) > 1 else 1 / abs(ratio)
    for factor, hint in FACTORS.items():
        if abs(size / factor - 1) < EXACT and ratio > 0:
            return Finding(level, file, row, name, what, f"Correct the unit: {hint}")
    remedy = "If it is a momentum, declare it as one, with its mass; otherwise correct its unit or frame"
    if content.momenta and ratio > 0:
        remedy = f"If its unit is right, its mass is {ratio:.4g} times the stated one: correct it (inertia)"
    return Finding(level, file, row, name, what, remedy)
