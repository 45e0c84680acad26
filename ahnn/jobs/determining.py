"""Orbit determination job: input files, fit, prediction of unseen measurements, output tables."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ahnn.data.files import epochs
from ahnn.data.files.cpf import read_cpf
from ahnn.data.files.messages import write_oem
from ahnn.data.files.units import unit
from ahnn.errors import TrainingError, UserError
from ahnn.evaluation.terminal import show
from ahnn.files import writable_folder, write_atomically
from ahnn.manifest import require_own
from ahnn.tracking.accelerations.acceleration_of_time import orbital_axes
from ahnn.tracking.formats.finals import installed_orientation
from ahnn.tracking.orbit_fit import OrbitFit, OrbitProblem, orbit_fit
from ahnn.tracking.orbit_problem import PreparedOrbit, prepared_orbit
from ahnn.tracking.orbit_setup import OrbitSetup
from ahnn.tracking.orbit_tables import (
    FRAME,
    acceleration_csv,
    learned_acceleration,
    orbit_ephemeris,
    residuals_csv,
    state_epoch,
    unknowns_csv,
)
from ahnn.tracking.residual_table import SHOWN, coverage, event_lines, pooled, residual_rows, table_lines
from ahnn.tracking.satellite_arc import SatelliteArc
from ahnn.tracking.suspected_mistakes import orientation_mistake, suspected_mistakes
from ahnn.tracking.tracking_data import EVENTS

log = logging.getLogger("ahnn")

FILES = ("residuals.csv", "unknowns.csv", "orbit.oem", "acceleration.csv", "summary.txt")
"""Output files of an orbit determination."""


@dataclass(frozen=True)
class OrbitRequest:
    """Request of `python -m ahnn.orbit`.

    Attributes:
        setup: setup of the determination.
        folder: base folder of the file names in the setup.
        out: output folder, or None.
        title: name of the setup.
    """

    setup: OrbitSetup
    folder: Path
    out: Path | None
    title: str


def determine(asked: OrbitRequest) -> None:
    """Determine an orbit, show and write the results.

    Raises:
        UserError: an invalid file or output folder.
        TrainingError: the fit failed.
    """
    if asked.out is None:
        return _determine(asked)
    with writable_folder(asked.out):
        require_own([asked.out / name for name in FILES], "out")
        _determine(asked)


def _determine(asked: OrbitRequest) -> None:
    ready = prepared_orbit(asked.setup, asked.folder)
    for remark in ready.problem.model.data.remarks:
        log.info("%s: %s", asked.setup.measurements, remark)
    fit = fit_or_mistake(ready)
    rows = residual_rows(fit, ready.problem.used)
    lines = [*headline(asked.title, fit), *table_lines(rows), *totals(fit)]
    mistakes = suspected_mistakes(ready.problem, fit.point, ready.rotation)
    lines += mistakes or event_lines(rows, fit.problem.model.data.event)
    if asked.setup.orientation:
        lines += orientation_mistake(ready.rotation.rows, installed_orientation(), ready.rotation)
    lines += learned_lines(ready, fit)
    if asked.setup.compare is not None:
        lines += compared(ready, fit.point.arc, asked.folder / asked.setup.compare)
    if asked.setup.held_out:
        lines += unseen_lines(ready, asked.setup.held_out)
    show("\n".join(lines))
    if asked.out is not None:
        write(asked.out, ready, fit, asked.setup.step, lines)


def fit_or_mistake(ready: PreparedOrbit) -> OrbitFit:
    """Return the fit of a problem; raises TrainingError with the suspected mistake, if any, as its cause."""
    try:
        return orbit_fit(ready.problem)
    except TrainingError as error:
        words = suspected_mistakes(ready.problem, None, ready.rotation)
        if not words:
            raise
        message = f"orbit: {'; '.join(words)} (the fit of all measurements failed)"
        raise TrainingError(message) from error


def headline(title: str, fit: OrbitFit) -> list[str]:
    """Return a summary of the fit and its convergence."""
    data = fit.problem.model.data
    count = int(np.isfinite(fit.point.residuals[fit.problem.used]).sum())
    ended = "converged" if fit.converged else "NOT converged"
    times = data.times[fit.problem.used]
    hours = (times[-1] - times[0]) / 3600
    name = f"{title}: {data.object}" if data.object else title
    stations = f"{len(data.stations)} station{'s' if len(data.stations) > 1 else ''}"
    free = int(fit.problem.unknowns.free.sum())
    return [
        f"{name}: {count} measurements of {stations} over {hours:.1f} h, {free} unknowns, {ended} in "
        f"{fit.steps} steps",
        f"estimated state: {FRAME}, at {state_epoch(fit)} UTC",
        f"times: of {EVENTS[data.event]} (event: {data.event}), in UTC",
        "residuals, measured minus predicted:",
    ]


def totals(fit: OrbitFit) -> list[str]:
    """Return the standard deviation of all residuals, one line per kind."""
    lines = []
    for kind, (count, sd) in pooled(fit, fit.problem.used).items():
        shown, factor = SHOWN[kind]
        lines.append(f"  all {kind}: {count} with a standard deviation of {factor * sd:.4g} {shown}")
    return lines


def learned_lines(ready: PreparedOrbit, fit: OrbitFit) -> list[str]:
    """Return lines on the size of the learned acceleration, if any, over the measurement span."""
    if ready.learned is None:
        return []
    term, place = ready.learned
    data = fit.problem.model.data
    first, last = min(fit.problem.at, data.times[0]), data.times[-1]
    _, _, norms = learned_acceleration(fit, term, place, np.linspace(first, last, 5))
    words = ", ".join(f"{value:.3e} ± {sd:.1e}" for value, sd in norms)
    lines = [f"learned acceleration in m/s² at the start, quarters and end: {words}"]
    if fit.smooth is not None:
        lines.append(
            f"  smoothness from the evidence: about {1e3 * fit.smooth.deviation * term.basis.unit:.2g} m/s², "
            f"changing over {fit.smooth.length / 3600:.1f} h"
        )
    return lines


def without_learned(problem: OrbitProblem, ready: PreparedOrbit) -> OrbitProblem:
    """Return a problem without its learned acceleration."""
    assert ready.learned is not None
    term, place = ready.learned
    deviations = problem.unknowns.deviations.copy()
    deviations[place : place + len(term.parameters)] = 0.0
    unknowns = replace(problem.unknowns, deviations=deviations, smooth=())
    return replace(problem, unknowns=unknowns, smooth=None)


def unseen_lines(ready: PreparedOrbit, fraction: float) -> list[str]:
    """Fit all but the last measurements, and report how well these are predicted."""
    times = ready.problem.model.data.times
    used = np.arange(len(times)) < round((1 - fraction) * len(times))
    part = replace(ready.problem, used=used)
    fits = {"with the learned acceleration" if ready.learned else "forecast": orbit_fit(part)}
    if ready.learned is not None:
        fits["without it"] = orbit_fit(without_learned(part, ready))
    lines = [f"the last {int((~used).sum())} of {len(used)} times, unseen, within 2 standard deviations:"]
    for name, fit in fits.items():
        words = []
        for kind, (count, inside, rms) in coverage(fit, ~used).items():
            size = "" if kind == "all" else f", rms {SHOWN[kind][1] * rms:.3g} {SHOWN[kind][0]}"
            words.append(f"{kind} {100 * inside:.1f} % of {count}{size}")
        lines.append(f"  {name}: {'; '.join(words)}")
    return lines


def compared(ready: PreparedOrbit, arc: SatelliteArc, path: Path) -> list[str]:
    """Return the distance of an orbit from a prediction (CPF), over their common time span.

    Raises:
        UserError: a different format, or no common time span.
    """
    content = read_cpf(path)
    data = ready.problem.model.data
    assert content.epoch is not None
    scale, second = unit(content.units.position).size / 1e3, unit(content.units.time).size
    track = content.tracks[0]
    times = (content.epoch - data.epoch) / epochs.SECOND + second * np.asarray(track.times)
    inside = (times >= arc.first) & (times <= arc.last)
    if not inside.any():
        message = f"compare: expected an orbit that covers the measurements; received {path}, which does not"
        raise UserError(message)
    states, turns = arc.states(times[inside]), ready.rotation.matrices(times[inside])
    theirs = np.einsum("tji,tj->ti", turns, scale * np.asarray(track.values)[inside, :3])
    off = 1e3 * (states[:, :3] - theirs)
    axes = orbital_axes(states[:, :3], states[:, 3:])
    radial, along, normal = np.sqrt(np.mean(np.einsum("tij,ti->tj", axes, off) ** 2, axis=0))
    size = np.linalg.norm(off, axis=1)
    return [
        f"from {path.name}, {inside.sum()} positions: {np.sqrt(np.mean(size**2)):.3f} m rms, "
        f"{size.max():.3f} m at most (rms radial {radial:.3f}, along {along:.3f}, normal {normal:.3f} m)"
    ]


def write(out: Path, ready: PreparedOrbit, fit: OrbitFit, step: float, lines: list[str]) -> None:
    """Write the tables, the orbit and the displayed text."""
    write_atomically(out / "residuals.csv", residuals_csv(fit))
    write_atomically(out / "unknowns.csv", unknowns_csv(fit))
    write_oem(out / "orbit.oem", [orbit_ephemeris(fit, step)])
    if ready.learned is not None:
        data, (term, place) = fit.problem.model.data, ready.learned
        times = np.linspace(min(fit.problem.at, data.times[0]), data.times[-1], 101)
        write_atomically(out / "acceleration.csv", acceleration_csv(fit, term, place, times))
    write_atomically(out / "summary.txt", ("\n".join(lines) + "\n").encode())
