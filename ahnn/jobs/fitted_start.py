"""Start of an assimilation, fitted to its first measurements with the learned flow."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import NamedTuple, cast

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector

from ahnn.assimilation import StreamSensor
from ahnn.assimilation.cells import BadLine
from ahnn.assimilation.instrument_reading import Reading
from ahnn.assimilation.line_parser import Layout
from ahnn.assimilation.lines import Lines
from ahnn.assimilation.skipped_lines import SkippedLines
from ahnn.assimilation.stream_clock import StreamClock
from ahnn.data.estimate_table import track_names
from ahnn.data.files.object_name import numbered
from ahnn.data.start_states import Starts
from ahnn.dynamics import has_field
from ahnn.dynamics.variations import jacobians_of_steps
from ahnn.errors import TrainingError, UserError
from ahnn.evaluation.goodness_of_fit import OUTLYING
from ahnn.labels import quantity
from ahnn.measurements import Instrument, Locating, Segment, Several, State
from ahnn.measurements.smoothing import guess, located_at
from ahnn.runs import Run
from ahnn.shooting.initial_states import LOST, Fitted, Trial, fit_starts, linearised, refine
from ahnn.shooting.path_sensitivities import Steps, path, steps_between
from ahnn.shooting.quadrature import coarse
from ahnn.shooting.robust import ROBUST
from ahnn.tracking.initial_orbit import orbit_of_positions
from ahnn.types import Space
from ahnn.uncertainty import forecast_columns

log = logging.getLogger("ahnn")

TAKEN = 20
"""Default number of fitted measurements."""
TRIED = 32
"""Number of training states from which a fit is tried."""
ITERATIONS = 30
"""Maximum number of iterations from the best of these states."""
MOST = 0.2
"""Maximum number of outliers, as a fraction of all other measurements."""
UNSEEN = 1e-7
"""Ratio of smallest to largest singular value of the design matrix below which a fit is undetermined."""


class FittedStart(NamedTuple):
    """Start of a filter.

    Attributes:
        start: state and covariance at the time of the last fitted measurement.
        line: line number of that measurement; lines up to it are not assimilated again.
    """

    start: Starts
    line: int


class BestFit(NamedTuple):
    """Fit of one state to measurements by least squares.

    Attributes:
        trial: flow with its Jacobians, and the loss.
        segment: measurements, NaN in place of outliers.
        steps: steps between measurement times.
        path: fitted path.
    """

    trial: Trial
    segment: Segment
    steps: Steps
    path: Fitted


def fitted_start(
    run: Run, sensors: Mapping[str, StreamSensor], file: str, clock: StreamClock, wanted: float | None
) -> FittedStart:
    """Fit a state to the first measurements of a file by robust least squares.

    The covariance accounts for noise, learned parameters and sensor biases, and is multiplied by chi-square
    per degree of freedom if that exceeds 1.

    Args:
        run: a trained model.
        sensors: sensors of the stream.
        file: path of the measurements.
        clock: interpretation of the measurement times.
        wanted: number of measurements, or a fraction below 1; None for `TAKEN`.

    Raises:
        UserError: no file, a model whose forces depend on time or controls, or too few measurements.
        TrainingError: no state fits.
    """
    if run.dynamics.clock:
        message = "start: expected numbers or a file, since forces depend on time or controls; received fit"
        raise UserError(message)
    lines = first_readings(sensors, file, clock, wanted)
    segment, bias_sd = segment_of([reading for _, reading in lines], sensors, run)
    size = len(run.space.components)
    if int(segment.measured) < size or segment.times.shape[1] < 2:
        message = f"start: expected {size} values or more, at two times or more; received {len(lines)} "
        raise UserError(message + "measurements. Fit more with fitted=N, or set start=")
    best = best_fit(run, segment)
    outliers, last = int(segment.measured - best.segment.measured), best.path.states[:, -1]
    chi_square = float(best.path.sums) / max(int(best.segment.measured) - size, 1)
    quality = f"chi-square {chi_square:.3g} per degree of freedom, {outliers} outliers"
    if not (chi_square <= LOST and outliers <= MOST * int(segment.measured)):
        message = (
            f"start: expected a state that fits the first {len(lines)} measurements; received none: "
            f"{quality}. Fit fewer with fitted=N, or set start="
        )
        raise TrainingError(message)
    covariance = max(1.0, chi_square) * covariance_of(run, best, bias_sd)
    moment, state = clock.said(float(segment.times[0, -1])), state_text(last[0], covariance, run.space)
    what = (
        "start: fitted to the first %d measurements, up to line %d (%s): at %s, %s; the filter goes on there"
    )
    log.info(what, len(lines), lines[-1][0], quality, moment, state)
    start = Starts(numbered(1), last, segment.times[:, -1], covariances=covariance[None])
    return FittedStart(start, lines[-1][0])


def best_fit(run: Run, segment: Segment) -> BestFit:
    """Return the best fit from any candidate state, after removal of outliers."""
    theta = parameters_to_vector(run.dynamics.parameters())
    jacobians = partial(jacobians_of_steps(run.dynamics, torch.float64), theta)
    trial, tried = Trial(run.dynamics.increment, jacobians, ROBUST["student"]), candidates(run, segment)
    steps, every = steps_between(segment.times, run.dt), torch.zeros(len(tried), dtype=torch.int64)
    found = fit_starts(trial, tried, segment.rows(every), steps.rows(every))
    best = found.rows(found.sums.argmin()[None])
    if has_field(run.dynamics) and coarse(run.dynamics.field, best.states, steps.lengths):
        steps = steps.quarters()
    fitted = refine(trial, best.starts, segment, steps, ITERATIONS)
    far = segment.residuals(fitted.states[:, steps.ends]).abs() > OUTLYING
    segment = segment._replace(values=segment.values.masked_fill(far, torch.nan))
    trial = trial._replace(robust=ROBUST["none"])
    return BestFit(trial, segment, steps, refine(trial, fitted.starts, segment, steps, ITERATIONS))


def first_readings(
    sensors: Mapping[str, StreamSensor], file: str, clock: StreamClock, wanted: float | None
) -> list[tuple[int, Reading]]:
    """Return the first measurements of a file in file order, with their line numbers; raises UserError."""
    if file == "-":
        message = "start: expected measurements=FILE with start=fit, which reads its first lines twice; "
        raise UserError(message + "received standard input")
    found, layout, header = list[tuple[int, Reading]](), None, ""
    most, skipped = TAKEN if wanted is None else round(wanted) if wanted >= 1 else None, SkippedLines()
    with Path(file).open("rb") as stream:
        lines = Lines(stream)
        for text in itertools.takewhile(lambda _: most is None or len(found) < most, lines):
            if not text or text.startswith("#") or (layout and layout.names and text == header):
                continue
            if layout is None:
                layout, header = Layout(text, sensors, clock), text
                if layout.names:
                    continue
            try:
                reading = layout.reading(text)
            except BadLine as error:
                skipped.add(lines.number, error)
                continue
            if not reading.is_empty:
                found.append((lines.number, reading))
    skipped.conclude()
    if most is None:
        found = found[: round((wanted or 0.0) * len(found))]
    if not found:
        message = f"start: expected measurements in {file} to fit; received none"
        raise UserError(message)
    return found


def segment_of(
    readings: list[Reading], sensors: Mapping[str, StreamSensor], run: Run
) -> tuple[Segment, Tensor]:
    """Return readings side by side as one segment, and the standard deviations of their biases, (M,).

    Each combination of sensor and stated standard deviations is a group of columns.
    """
    groups = {(one.sensor, one.deviations): [] for one in readings}
    times = sorted({one.time for one in readings})
    models = [sensors[name].measurement for name, _ in groups]
    deviations = [sd for name, own in groups for sd in own or sensors[name].deviations or ()]
    biases = [(b.deviations if (b := sensors[name].biases) else None, sensors[name]) for name, _ in groups]
    bias_sd = [sd for own, sensor in biases for sd in own or (0.0,) * len(sensor.columns)]
    values = torch.full((1, len(times), len(deviations)), torch.nan, dtype=torch.float64)
    first = dict(zip(groups, itertools.accumulate((len(m.names) for m in models), initial=0), strict=False))
    for one in readings:
        column = first[one.sensor, one.deviations]
        row = torch.tensor(one.values, dtype=torch.float64)
        values[0, times.index(one.time), column : column + len(row)] = row
    space = run.space
    noise = torch.tensor(deviations, dtype=torch.float64)
    instrument = Instrument(Several(models), noise, run.dt, space.dof, space.factor)
    at = torch.tensor([times], dtype=torch.float64)
    return Segment(values, at, instrument), torch.tensor(bias_sd, dtype=torch.float64)


def candidates(run: Run, segment: Segment) -> Tensor:
    """Return candidate states (C, D) at the first time: training states, and guesses from measurements."""
    nothing = segment.values.new_zeros(1, len(run.space.components))
    states = nothing if run.domain is None else run.domain.states
    tried = [states[:: -(-len(states) // TRIED)]]
    models = cast(Several, segment.instrument.measurement).models
    alike = len({isinstance(model, State) for model in models}) == 1
    if alike and all(isinstance(model, Locating) for model in models):
        tried.append(guess(segment))
        if (orbit := orbit_guess(run, segment)) is not None:
            tried.append(orbit)
    whole = torch.cat(tried)
    return whole[whole.isfinite().all(-1)]


def orbit_guess(run: Run, segment: Segment) -> Tensor | None:
    """Return the state (1, D) at the first time by Gibbs or Herrick-Gibbs; None where these do not apply."""
    space = run.space
    if (space.dof, space.units.position, space.units.velocity) != (3, "km", "km/s"):
        return None
    places, times = located_at(segment.instrument, segment.values, segment.times)[0], segment.times[0]
    there = places.isfinite().all(-1)
    found = orbit_of_positions(places[there].numpy(), times[there].numpy())
    if found is None:
        return None
    state, time = torch.from_numpy(found[0])[None] * space.scales, found[1]
    back = steps_between(times.new_tensor([[0.0, time - float(times[0])]]), run.dt)
    return path(run.dynamics.increment, state, -back.lengths)[:, -1]


def covariance_of(run: Run, best: BestFit, bias_sd: Tensor) -> Tensor:
    """Return the covariance (D, D) of the last state of a fitted path.

    It accounts for noise, and for parameters and biases that the fit treats as known (consider covariance;
    Tapley, Schutz & Born 2004, chapter 6).

    Raises:
        UserError: measurements that do not determine all components.
    """
    trial, segment, steps, fitted = best
    here = linearised(trial, fitted.states, segment, steps)
    design = here.of_start[0].flatten(0, 1)
    scale = design.norm(dim=0)
    values = torch.linalg.svdvals(design / torch.where(scale > 0, scale, torch.ones_like(scale)))
    if not bool((scale > 0).all()) or values[-1] < UNSEEN * values[0]:
        message = (
            f"start: expected measurements that determine {len(scale)} components; received "
            f"{int(segment.measured)} numbers, which leave some undetermined. Fit more with fitted=N, or "
            "set start="
        )
        raise UserError(message)
    count = sum(parameter.numel() for parameter in run.dynamics.parameters())
    spread = torch.zeros(count, 1, dtype=torch.float64) if run.uncertainty is None else run.uncertainty.spread
    every = torch.ones(segment.times.shape, dtype=torch.bool)
    noise, moved = next(forecast_columns(run.dynamics, fitted.states, steps, here, every, spread))
    of_bias = torch.diag_embed((~segment.values[0].isnan()) / segment.instrument.deviations).flatten(0, 1)
    biased = noise[0, -1] @ torch.linalg.qr(design).Q.mT @ (of_bias * bias_sd)
    causes = torch.cat((noise[0, -1], moved[0, -1], biased), dim=-1)
    return causes @ causes.mT


def state_text(state: Tensor, covariance: Tensor, space: Space) -> str:
    """Format a state (D,) with standard deviations and units."""
    values, sds = (state / space.scales).tolist(), (covariance.diagonal().sqrt() / space.scales).tolist()
    texts = [f"{n} {v:.6g} ± {sd:.2g}" for n, v, sd in zip(track_names(space), values, sds, strict=True)]
    halves = texts[: space.dof], texts[space.dof :]
    units = (quantity(space, name)[1] for name in ("position", "velocity"))
    return ", ".join(f"{', '.join(half)} {unit}" for half, unit in zip(halves, units, strict=True))
