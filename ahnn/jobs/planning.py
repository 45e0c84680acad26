"""Planning job: sessions of ground stations, or position fixes, that make a forecast most precise."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.func import jacrev, vmap
from torch.nn.functional import pad

from ahnn.arguments import Count, Positive
from ahnn.data.files.epochs import spelled
from ahnn.data.starts import Starts
from ahnn.errors import UserError
from ahnn.evaluation.terminal import show
from ahnn.files import write_atomically
from ahnn.jobs.asked_starts import asked_starts
from ahnn.jobs.named import named_runs
from ahnn.loading import unfinished_training, warn_once
from ahnn.manifest import require_own
from ahnn.measurements import noise_deviations, observe, reading
from ahnn.measurements.station_file import StationsOfFile
from ahnn.prediction import durations
from ahnn.prediction.measurement_plan import evenly_spaced, plan_measurements, variance_with
from ahnn.prediction.propagation import prediction_factors
from ahnn.runs import Run
from ahnn.tracking.earth_axes import earth_axes

log = logging.getLogger("ahnn")

PlannedSession = tuple[str, str, str, int]
"""Name of the instrument, beginning, end and number of measurements."""


@dataclass(frozen=True, kw_only=True)
class PlanRequest:
    """Options of `python -m ahnn.plan`, described in its help."""

    start: str | list[Any]
    start_sd: list[Positive] | None = None
    duration: str | float
    every: str | float
    at: str | float | None = None
    session: str | float | None = None
    choose: Count
    stations: str | None = None
    position_sd: list[Positive] | Positive | None = None
    run: str | None = None
    pretrained: str | None = None
    ckpt: str = "best"
    output: str | None = None
    epoch: str | None = None
    frame: str | list[str] | None = None


class PlannedSensor(NamedTuple):
    """A sensor that a plan may use.

    Attributes:
        name: name of the station, or `fix`.
        model: map (x (D,), t) -> M values.
        deviations, bias_sd: (M,) standard deviations of the noise and of constant biases.
        joined: whether measurements without a gap form one session, a pass.
    """

    name: str
    model: Any
    deviations: Tensor
    bias_sd: Tensor
    joined: bool


class Candidate(NamedTuple):
    """Session: measurements that are chosen together.

    Attributes:
        name: name of the instrument.
        samples: (K,) indices of the measurement times.
        rows: (K M, R) derivatives with respect to the unknowns, divided by the standard deviations.
    """

    name: str
    samples: Tensor
    rows: Tensor


def plan(asked: PlanRequest) -> None:
    """Choose measurements, compare the plan with equal spacing, and write it if requested.

    Raises:
        UserError: a missing run, invalid starts, stations or durations, or nothing to choose from.
    """
    (run,) = named_runs(asked.run, asked.pretrained, asked.ckpt)
    if remark := unfinished_training(run.folder):
        warn_once(remark)
    if asked.output is not None:
        require_own([Path(asked.output)], "output")
    begin = asked_starts(asked.start, asked.start_sd, asked.epoch, asked.frame, run.space)
    if begin.covariances is None or len(begin.states) > 1:
        received = "none" if len(begin.states) == 1 else f"{len(begin.states)} starts"
        message = f"start: expected one state with its standard deviations; received {received}. Add start_sd"
        raise UserError(message)
    clock, position = run.space.units.time, run.space.units.position
    lasting, every = (durations.duration(getattr(asked, k), k, clock) for k in ("duration", "every"))
    at = lasting if asked.at is None else durations.duration(asked.at, "at", clock)
    session = math.inf if asked.session is None else durations.duration(asked.session, "session", clock)
    times = durations.grid(lasting, every)
    whole = torch.cat((times, torch.tensor([at]).to(times))).unique()
    instruments = stations_of(asked.stations, begin, run) if asked.stations else fixes(asked.position_sd, run)
    states, factors = prediction_factors(
        run.dynamics.frozen(), begin.states[0], whole, run.dt, run.knowledge(begin.covariances[0])
    )
    seen = states[: len(times)], factors[: len(times)], times + begin.times[0]
    found = candidates(instruments, *seen, max(1, int(min(session / every, len(times)))))
    if not found:
        message = "plan: expected a station that sees the object; received none. Extend duration"
        raise UserError(message)
    rows = [one.rows for one in found]
    moved = factors[int((whole == at).nonzero()[0]), : run.space.dof]
    forecast = pad(moved, (0, rows[0].shape[1] - moved.shape[1]))  # biases of sensors do not move the object
    made = plan_measurements(rows, forecast, asked.choose)
    spreads = made.variances.sqrt().tolist()
    table = [row_of(found[k], times, begin, clock) for k in made.chosen]
    title = f"{run.folder.name}: forecast {at:g} {clock} ahead, {len(table)} of {len(found)} sessions"
    lines = [*lines_of(table, spreads, position), *beside(rows, forecast, len(table), spreads[-1])]
    show("\n".join([title, *aligned(lines)]))
    if asked.output is not None:
        scale = clock if begin.reference.epoch is None else begin.reference.clock or "UTC"
        write_atomically(Path(asked.output), as_csv(table, spreads[1:], scale, position).encode())


def lines_of(table: list[PlannedSession], spreads: list[float], unit: str) -> list[tuple[str, str]]:
    """Return text and value of each line: a session, and the standard deviation of the forecast after it."""
    lines = [("", f"position sd [{unit}]"), ("before", f"{spreads[0]:.4g}")]
    for (name, first, last, count), sd in zip(table, spreads[1:], strict=True):
        lines.append((f"{name}, {first} to {last}, {count} measurements", f"{sd:.4g}"))
    return lines


def aligned(lines: list[tuple[str, str]]) -> list[str]:
    """Return the lines of the summary, with the values in one column after the longest text."""
    width = max(66, *(len(text) for text, _ in lines))
    return [f"  {text:{width}s}{value:>22s}".rstrip() for text, value in lines]


def stations_of(file: str, begin: Starts, run: Run) -> list[PlannedSensor]:
    """Return the stations of a file, on an Earth that rotates from the epoch of time zero."""
    if begin.reference.epoch is None:
        log.warning("epoch: not given; the Greenwich meridian is assumed to lie on the x axis at time zero")
    made = []
    for name, model in StationsOfFile(file, earth_axes(begin.reference), run.space.mass).stations.items():
        sd, bias = (torch.tensor(part, dtype=torch.float64) for part in (model.deviations, model.bias_sd))
        made.append(PlannedSensor(name, model, sd, bias, joined=True))
    return made


def fixes(sd: list[float] | float | None, run: Run) -> list[PlannedSensor]:
    """Return a position sensor; each fix is a separate session.

    Raises:
        UserError: no standard deviations.
    """
    if sd is None:
        message = "plan: expected stations=FILE or position_sd=NUMBER; received neither"
        raise UserError(message)
    model = reading("position", run.space)
    spread = noise_deviations(model, sd, "position_sd").double()
    return [PlannedSensor("fix", model, spread, torch.zeros_like(spread), joined=False)]


def candidates(
    instruments: list[PlannedSensor], states: Tensor, factors: Tensor, times: Tensor, most: int
) -> list[Candidate]:
    """Return the sessions of instruments in the order of time.

    Args:
        instruments: instruments of possible measurements.
        states: (T, D) predicted states.
        factors: (T, D, R) factors of the covariances of the states.
        times: (T,) times of the states.
        most: maximum number of times in a session of a station.
    """
    biased = sum(int((one.bias_sd > 0).sum()) for one in instruments)
    found, used = [], 0
    for one in instruments:
        seen = observe(one.model, states, times).isfinite().all(-1)
        slopes = vmap(jacrev(one.model))(states, times)
        rows = pad(slopes @ factors, (0, biased))
        for m in (one.bias_sd > 0).nonzero().flatten().tolist():
            rows[:, m, factors.shape[-1] + used] = one.bias_sd[m]
            used += 1
        rows = rows / one.deviations.unsqueeze(-1)
        for samples in passes(seen):
            for part in samples.split(most if one.joined else 1):
                found.append(Candidate(one.name, part, rows[part].flatten(0, 1)))
    return sorted(found, key=lambda one: int(one.samples[0]))


def passes(seen: Tensor) -> list[Tensor]:
    """Return the indices of visible samples (T,), one tensor for each uninterrupted pass."""
    samples = seen.nonzero().flatten()
    gaps = (samples.diff() > 1).nonzero().flatten() + 1
    return [part for part in samples.tensor_split(gaps) if len(part)]


def row_of(one: Candidate, times: Tensor, begin: Starts, clock: str) -> PlannedSession:
    """Return name, beginning, end and number of measurements; times are epochs if time zero has one."""
    ends = [float(times[int(k)]) + float(begin.times[0]) for k in (one.samples[0], one.samples[-1])]
    if begin.reference.epoch is None:
        first, last = (f"{time:g}" for time in ends)
    else:
        utc = begin.reference.clock == "UTC"
        moments = [begin.reference.epoch + durations.picoseconds(time, clock) for time in ends]
        first, last = (spelled(moment, utc=utc)[:19] for moment in moments)
    return one.name, first, last, len(one.samples)


def beside(rows: list[Tensor], forecast: Tensor, count: int, reached: float) -> list[tuple[str, str]]:
    """Compare a plan with equally spaced sessions: the same number, and the number that is as precise."""
    lines = []
    for more in range(count, len(rows) + 1):
        equal = [rows[k] for k in evenly_spaced(len(rows), more)]
        spread = float(variance_with(equal, forecast).sqrt())
        if more == count:
            lines.append((f"{count} sessions at equal spacing", f"{spread:.4g}"))
        if spread <= reached:
            more_of = (f"{more} sessions at equal spacing", f"{spread:.4g}")
            return [*lines, more_of] if more > count else lines
    return lines


def as_csv(table: list[PlannedSession], spreads: list[float], scale: str, unit: str) -> str:
    """Return the plan as a table in the order of choice.

    Args:
        table: sessions.
        spreads: standard deviation of the forecast after each session.
        scale: time scale of the epochs, or unit of the times.
        unit: unit of the standard deviations.
    """
    lines = [f"instrument,begin [{scale}],end [{scale}],measurements,sd_after [{unit}]"]
    lines += [",".join((*map(str, row), f"{sd:.6g}")) for row, sd in zip(table, spreads, strict=True)]
    return "\n".join(lines) + "\n"
