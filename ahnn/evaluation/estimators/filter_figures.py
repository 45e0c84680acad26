"""Figures of a filter: errors with bands, consistency over time, comparison with pure prediction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from matplotlib.figure import Figure
from torch import Tensor

from ahnn.estimation.consistency import band
from ahnn.estimation.consistency_bands import nis_at_times
from ahnn.estimation.scenario import Setting
from ahnn.evaluation import Case, style
from ahnn.evaluation.case import Start
from ahnn.evaluation.estimators.outcome import Outcome, name
from ahnn.evaluation.estimators.series import Sawtooth, blocks, kept, rms_over_members, sawtooth, smoothed_rms
from ahnn.evaluation.titles import MODEL
from ahnn.evaluation.trajectory_figures import SMOOTHING

Chosen = dict[tuple[Start, bool], Outcome]
"""Plotted outcomes, by start and by whether it is a floor."""


def filter_figures(
    case: Case, setting: Setting, outcomes: Sequence[Outcome], without: dict[Start, Tensor]
) -> tuple[dict[str, Tensor], dict[str, Figure]]:
    """Build the named arrays and figures of an evaluation.

    The model's filter is plotted with the floor and from the perturbed start, if available.

    Args:
        case: evaluated case.
        setting: measurement settings and P0.
        outcomes: outcomes of all filters in all scenarios.
        without: (B, T + 1, D) predictions without a filter from each start.
    """
    chosen = drawn(outcomes)
    model = {start: outcome for (start, floor), outcome in chosen.items() if not floor}
    averages = _averages(case, chosen, without)
    arrays = {f"{start}_start": outcome.estimate for start, outcome in model.items()}
    arrays |= {f"{start}_nees": outcome.nees for start, outcome in model.items()}
    arrays |= {f"{s}_sma_{key}": value for s, series in averages.items() for key, value in series.items()}
    start: Start = "perturbed" if "perturbed" in model else "true"
    teeth = sawtooth(model[start])
    arrays |= {f"{start}_sawtooth_{key}": value for key, value in kept(teeth, _member(model[start])).items()}
    figures = {
        "error_band": error_against_band(case, chosen, start),
        "error": component_errors(case, model[start], teeth),
        "moving_average": averages_figure(case, chosen, averages),
        "consistency": consistency(case, setting, chosen),
        "state": states(case, model[start], teeth),
    }
    return arrays, figures


def drawn(outcomes: Sequence[Outcome]) -> Chosen:
    """Select the outcomes of the plain filter, which is listed first, for the model and the floor."""
    name = outcomes[0].who.estimator
    plain = (o for o in outcomes if o.who.estimator == name and (o.who.floor or o.who.process == MODEL))
    return {(o.who.start, o.who.floor): o for o in plain}


def _averages(case: Case, chosen: Chosen, without: dict[Start, Tensor]) -> dict[Start, dict[str, Tensor]]:
    """Return the moving averages (2, T + 1) of the errors of each start."""
    names = {False: "filter", True: "floor"}
    predictions: dict[Start, dict[str, Tensor]] = {start: {"without": x} for start, x in without.items()}
    for (start, floor), outcome in chosen.items():
        predictions[start][names[floor]] = outcome.estimate
    truth, inertia = case.test.states, case.space.divisor
    return {
        start: {key: smoothed_rms(x - truth, inertia) for key, x in several.items()}
        for start, several in predictions.items()
    }


def states(case: Case, outcome: Outcome, teeth: Sawtooth) -> Figure:
    """Plot every state component of one trajectory with its 3-sigma band, before and after updates."""
    figure, grid = _grid(case)
    b, axis = _member(outcome), style.time_axis(case)
    time = axis.at(teeth.sample).time
    truth, mean, deviation = _columns(case, case.test.states[b], teeth.mean[b], teeth.deviation[b])
    updates = _updates(outcome, b)
    for i, axes in enumerate(grid):
        low, high = mean[:, i] - 3 * deviation[:, i], mean[:, i] + 3 * deviation[:, i]
        axes.fill_between(time, low, high, color=style.BAND, alpha=0.5, lw=0, label="±3σ")
        axes.plot(time, mean[:, i], **style.MODEL, label=name(outcome, case))
        axes.plot(axis.time, truth[:, i], **style.TRUTH, label=style.reference(case))
        marks = {"color": style.BLACK, "marker": ".", "ms": 5, "ls": "none"}
        axes.plot(axis.time[updates], truth[updates, i], **marks, label="measurement times")
        style.frame(axes, [truth[:, i]], symmetric=False)
    _label(case, figure, grid, axis, "")
    figure.suptitle(f"{case.space.name}: filtered state of one unseen trajectory, {outcome.who.start} start")
    return figure


def component_errors(case: Case, outcome: Outcome, teeth: Sawtooth) -> Figure:
    """Plot the error of every state component of one trajectory with its 3-sigma band."""
    figure, grid = _grid(case)
    b, axis = _member(outcome), style.time_axis(case)
    time = axis.at(teeth.sample).time
    error, deviation = _columns(case, teeth.mean[b] - case.test.states[b, teeth.sample], teeth.deviation[b])
    settled = teeth.sample > outcome.first
    for i, axes in enumerate(grid):
        wide = 3 * deviation[:, i]
        axes.fill_between(time, -wide, wide, color=style.BAND, alpha=0.5, lw=0, label="±3σ")
        axes.axhline(0, color=style.BLACK, lw=0.6)
        axes.plot(time, error[:, i], **(style.MODEL | {"lw": 1.2}), label="estimate - truth")
        style.frame(axes, [wide[settled], error[settled, i]], symmetric=True)
        axes.ticklabel_format(axis="y", scilimits=(-3, 4))
    _label(case, figure, grid, axis, "error of ")
    what = f"{case.space.name}, {name(outcome, case)}: error of one unseen trajectory"
    figure.suptitle(f"{what}, {outcome.who.start} start\n(axis scaled to the values after the first update)")
    return figure


def error_against_band(case: Case, chosen: Chosen, start: Start) -> Figure:
    """Plot the rms error over all trajectories, with its standard deviation according to the filter."""
    figure = style.canvas(8, 6.4)
    panels = figure.subplots(2, 1, sharex=True)
    axis = style.time_axis(case)
    for outcome, look in _with_looks(chosen, start):
        teeth, label = sawtooth(outcome), _label_of(outcome, case)
        time = axis.at(teeth.sample).time
        error = rms_over_members(teeth.mean - case.test.states[:, teeth.sample], case.space.divisor)
        believed = rms_over_members(teeth.deviation, case.space.divisor)
        for i, axes in enumerate(panels):
            axes.plot(time, error[i], **(look | {"lw": 1.4}), label=f"{label}: error")
            axes.plot(time, believed[i], color=look["color"], lw=1.3, ls=":", label=f"{label}: filter σ")
    for axes in panels:
        style.logarithmic(axes, 1)
    style.label_errors(case, panels)
    style.legend_below(figure, panels[0])
    count = len(case.test.states)
    panels[0].set_title(f"{case.space.name}: rms error over {count} unseen trajectories, {start} start")
    style.label_time(panels[-1], axis)
    return figure


MARKS = {("perturbed", True): "s", ("perturbed", False): "o", ("true", False): "x"}
"""Markers of NIS, which are not joined by a line because the values are independent of one another."""


def consistency(case: Case, setting: Setting, chosen: Chosen) -> Figure:
    """Plot the mean NEES, and NIS per measured value, of all trajectories over time with 95 % bands."""
    figure = style.canvas(8, 6.6)
    panels = figure.subplots(2, 1, sharex=True)
    axis, members = style.time_axis(case), len(case.test.states)
    looks: dict[tuple[Start, bool], dict[str, Any]] = {
        ("perturbed", True): style.FLOOR,
        ("perturbed", False): style.MODEL,
        ("true", False): style.ALONE,
    }
    for key, look in looks.items():
        if key not in chosen:
            continue
        outcome, label = chosen[key], f"{_label_of(chosen[key], case)}, {key[0]} start"
        panels[0].plot(axis.time, outcome.nees.nanmean(0), **(look | {"lw": 1.3}), label=label)
        nis, *_ = nis_at_times(outcome.result.nis, outcome.result.measured)
        panels[1].plot(axis.time[1:], nis, **(look | {"ls": "none"}), marker=MARKS[key], ms=4, mfc="none")
    size, first = case.test.states.shape[-1], next(iter(chosen.values())).result
    _, low, high = nis_at_times(first.nis, first.measured)
    times, there = axis.time[1:], low.isfinite()
    shown = {"color": style.BAND, "alpha": 0.45, "lw": 0}
    panels[0].axhspan(*band(size, members), label="95 % band", **shown)
    # The band varies with time if sensors do not measure all members.
    panels[1].fill_between(times[there], low[there], high[there], **shown)
    panels[0].set_ylabel(f"mean NEES ({size} if consistent)")
    panels[1].set_ylabel("NIS per measured value\n(1 if consistent)")
    style.logarithmic(panels[0], setting.first)
    style.logarithmic(panels[1], 0)
    style.legend_below(figure, panels[0])
    panels[0].set_title(f"{case.space.name}: consistency over {members} unseen trajectories")
    style.label_time(panels[-1], axis)
    return figure


def averages_figure(case: Case, chosen: Chosen, averages: dict[Start, dict[str, Tensor]]) -> Figure:
    """Plot the moving average of the rms error with and without a filter, from each start."""
    figure = style.canvas(10 if len(averages) > 1 else 7, 6.2)
    panels = figure.subplots(2, len(averages), sharex=True, sharey="row", squeeze=False)
    axis = style.time_axis(case)
    names = {o.who.floor: _label_of(o, case) for o in chosen.values()}
    looks = {
        "without": (f"{case.label}, no filter", style.ALONE),
        "floor": (names.get(True), style.FLOOR),
        "filter": (names.get(False), style.MODEL),
    }
    first = max(outcome.first for outcome in chosen.values())
    for column, (start, series) in zip(panels.T, averages.items(), strict=True):
        for key, (label, look) in looks.items():
            for axes, curve in zip(column, series.get(key, ()), strict=False):
                axes.plot(axis.time, curve, **look, label=label)
        column[0].set_title(f"{start} start")
        style.label_time(column[-1], axis)
    style.label_errors(case, panels[:, 0])
    for row in panels:
        style.logarithmic(row[0], first, row[1:])
        for axes in row:
            axes.grid(alpha=0.3)
    style.legend_below(figure, *panels.flat)
    count = len(case.test.states)
    head = f"{case.space.name}: rms error over {count} unseen trajectories"
    figure.suptitle(f"{head}, mean of the last {SMOOTHING} samples")
    return figure


def _with_looks(chosen: Chosen, start: Start) -> list[tuple[Outcome, dict[str, Any]]]:
    """Return the floor, if any, and the model of a start with their styles."""
    looks = {True: style.FLOOR, False: style.MODEL}
    return [(chosen[start, floor], look) for floor, look in looks.items() if (start, floor) in chosen]


def _label_of(outcome: Outcome, case: Case) -> str:
    return f"floor: {name(outcome, case)}" if outcome.who.floor else name(outcome, case)


def _grid(case: Case) -> tuple[Figure, list[Any]]:
    """Return a figure with one panel per component, positions in the left column."""
    n = case.space.dof
    figure = style.canvas(11, 2.4 * n + 1.4)
    panels = figure.subplots(n, 2, sharex=True, squeeze=False)
    return figure, [*panels[:, 0], *panels[:, 1]]


def _label(case: Case, figure: Figure, grid: list[Any], axis: style.Axis, prefix: str) -> None:
    for axes, text in zip(grid, style.state_labels(case), strict=True):
        axes.set_ylabel(prefix + text)
        axes.grid(alpha=0.3)
    for last in (grid[case.space.dof - 1], grid[-1]):
        style.label_time(last, axis)
    figure.align_ylabels(grid)
    style.legend_below(figure, grid[0])


def _columns(case: Case, *values: Tensor) -> list[Tensor]:
    """Return states, or errors, (T, D) with velocities in place of momenta."""
    return [torch.cat(blocks(x, case.space.divisor), dim=-1) for x in values]


def _member(outcome: Outcome) -> int:
    """Return the index of the first trajectory that was not lost, or 0 if all were."""
    return int((outcome.result.status != 0).to(torch.int64).argmin())


def _updates(outcome: Outcome, b: int) -> Tensor:
    """Return the samples at which member b was measured."""
    return torch.nonzero(outcome.result.measured[b] > 0).flatten() + 1
