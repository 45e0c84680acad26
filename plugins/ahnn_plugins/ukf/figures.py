"""Pictures of a filter: state and error with their bands, consistency over time, what a filter gains."""

from __future__ import annotations

from typing import Any

import torch
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from torch import Tensor

from ahnn.estimation.consistency import band
from ahnn.estimation.scenario import Setting
from ahnn.evaluation import Case
from ahnn.evaluation.figures import SMOOTHING
from ahnn_plugins.ukf.outcome import Outcome
from ahnn_plugins.ukf.series import Sawtooth, blocks, rms_over_members, sawtooth, smoothed_rms

MODEL, FLOOR, NONE = "tab:red", "tab:gray", "tab:blue"
NAMES = ("position", "velocity")


def ukf_figures(
    case: Case, setting: Setting, outcomes: list[Outcome], without: dict[str, Tensor]
) -> tuple[dict[str, Tensor], dict[str, Figure]]:
    """Return the arrays and the figures of an evaluation under their names.

    The first filter of the model is drawn, beside the floor.

    Args:
        case: the model.
        setting: measurements and P0.
        outcomes: of all filters in all scenarios.
        without: (B, T + 1, D) predictions without a filter from each start.
    """
    named = outcomes[0].name, next(o.name for o in outcomes if o.floor)
    model, floor = ({o.start: o for o in outcomes if o.name == name} for name in named)
    perturbed = sawtooth(model["perturbed"])
    averages = {
        start: {
            "without": smoothed_rms(without[start] - case.test.states, case.system.inertia),
            "filter": smoothed_rms(model[start].estimate - case.test.states, case.system.inertia),
            "floor": smoothed_rms(floor[start].estimate - case.test.states, case.system.inertia),
        }
        for start in model
    }
    arrays = {f"{start}_start": outcome.estimate for start, outcome in model.items()}
    arrays |= {f"{start}_nees": outcome.nees for start, outcome in model.items()}
    arrays |= {f"{s}_sma_{key}": value for s, series in averages.items() for key, value in series.items()}
    figures = {
        "state": states(case, model["perturbed"], perturbed),
        "error": component_errors(case, model["perturbed"], perturbed),
        "error_band": error_against_band(
            case, model["perturbed"].name, perturbed, sawtooth(floor["perturbed"])
        ),
        "consistency": consistency(case, setting, model, floor),
        "moving_average": averages_figure(case, model["true"], averages),
    }
    return arrays, figures


def states(case: Case, outcome: Outcome, teeth: Sawtooth) -> Figure:
    """Draw every state component of one trajectory with its 3-sigma band, before and after updates."""
    figure, grid = _grid(case)
    b = _member(outcome)
    time, unit = time_axis(case, teeth.sample)
    truth, mean, deviation = _columns(case, case.test.states[b], teeth.mean[b], teeth.deviation[b])
    updates = _updates(outcome, b)
    for i, axes in enumerate(grid):
        low, high = mean[:, i] - 3 * deviation[:, i], mean[:, i] + 3 * deviation[:, i]
        axes.fill_between(time, low, high, color=MODEL, alpha=0.25, lw=0, label="±3σ")
        axes.plot(time, mean[:, i], color=MODEL, lw=1.4, label=outcome.name)
        at = time_axis(case, torch.arange(len(truth)))[0]
        axes.plot(at, truth[:, i], color="black", lw=1.0, ls="--", label="truth")
        axes.plot(at[updates], truth[updates, i], ".", color="black", ms=4, label="measurement times")
        _frame(axes, [truth[:, i]], symmetric=False)
    _label(case, figure, grid, (time, unit), "")
    figure.suptitle(f"{case.system.name}: filtered state of one unseen trajectory, perturbed start")
    return figure


def component_errors(case: Case, outcome: Outcome, teeth: Sawtooth) -> Figure:
    """Draw the error of every state component of one trajectory in its 3-sigma band."""
    figure, grid = _grid(case)
    b = _member(outcome)
    time, unit = time_axis(case, teeth.sample)
    error, deviation = _columns(case, teeth.mean[b] - case.test.states[b, teeth.sample], teeth.deviation[b])
    settled = teeth.sample > outcome.first
    for i, axes in enumerate(grid):
        axes.fill_between(
            time, -3 * deviation[:, i], 3 * deviation[:, i], color=MODEL, alpha=0.2, lw=0, label="±3σ"
        )
        axes.axhline(0, color="black", lw=0.6)
        axes.plot(time, error[:, i], color=MODEL, lw=1.2, label="estimate - truth")
        _frame(axes, [3 * deviation[settled, i], error[settled, i]], symmetric=True)
    _label(case, figure, grid, (time, unit), "error of ")
    figure.suptitle(
        f"{case.system.name}, {outcome.name}: error of one unseen trajectory, perturbed start\n"
        f"(the scale is that of the time after the first update)"
    )
    return figure


def error_against_band(case: Case, name: str, teeth: Sawtooth, floor: Sawtooth) -> Figure:
    """Draw the rms error over all trajectories beside the one that the filter believes in."""
    figure = Figure(figsize=(8, 6), layout="constrained")
    panels = figure.subplots(2, 1, sharex=True)
    time, unit = time_axis(case, teeth.sample)
    for curve, label, color in ((floor, "exact flow + UKF", FLOOR), (teeth, name, MODEL)):
        error = rms_over_members(curve.mean - case.test.states[:, curve.sample], case.system.inertia)
        believed = rms_over_members(curve.deviation, case.system.inertia)
        for i, axes in enumerate(panels):
            axes.plot(time, error[i], color=color, lw=1.2, label=f"{label}: error")
            axes.plot(time, believed[i], color=color, lw=1.0, ls=":", label=f"{label}: σ")
    for axes, quantity in zip(panels, NAMES, strict=True):
        axes.set_ylabel(f"{quantity} error [{getattr(case.system.units, quantity)}]")
        _logarithmic(axes, 1)
    _legend_below(figure, panels[0])
    panels[0].set_title(
        f"{case.system.name}: rms error over {len(case.test.states)} unseen trajectories, perturbed start"
    )
    _time(panels[-1], time, unit)
    return figure


def consistency(case: Case, setting: Setting, model: dict[str, Outcome], floor: dict[str, Outcome]) -> Figure:
    """Draw NEES and NIS, averaged over trajectories, over time with their 95 % bands."""
    figure = Figure(figsize=(8, 6), layout="constrained")
    panels = figure.subplots(2, 1, sharex=True)
    members, samples, size = model["perturbed"].estimate.shape
    time, unit = time_axis(case, torch.arange(samples))
    curves = [(floor["perturbed"], FLOOR, "-"), (model["true"], NONE, "-"), (model["perturbed"], MODEL, "-")]
    for outcome, color, style in curves:
        label = f"{outcome.name}, {outcome.start} start"
        panels[0].plot(time, outcome.nees.nanmean(0), color=color, ls=style, lw=1.2, label=label)
        nis = outcome.result.nis.nanmean(0)
        there = nis.isfinite()
        panels[1].plot(time[1:][there], nis[there], color=color, ls=style, lw=1.2, marker=".", label=label)
    titles = (("NEES", size), ("NIS", len(setting.measurement.names)))
    for axes, (name, count) in zip(panels, titles, strict=True):
        axes.axhspan(*band(count, members), color="tab:green", alpha=0.3, lw=0, label="95 % band")
        axes.axhline(count, color="tab:green", lw=0.8)
        axes.set_ylabel(f"mean {name} ({count} if consistent)")
    _logarithmic(panels[0], setting.first)
    _logarithmic(panels[1], 0)
    _legend_below(figure, panels[0])
    panels[0].set_title(f"{case.system.name}: consistency over {members} unseen trajectories")
    _time(panels[-1], time, unit)
    return figure


def averages_figure(case: Case, outcome: Outcome, averages: dict[str, dict[str, Tensor]]) -> Figure:
    """Draw the moving average of the rms error with and without a filter, from both starts."""
    figure = Figure(figsize=(10, 6), layout="constrained")
    panels = figure.subplots(2, len(averages), sharex=True, sharey="row")
    labels = (("without", f"{case.label}, no filter", NONE), ("floor", "exact flow + UKF", FLOOR))
    time, unit = time_axis(case, torch.arange(case.test.states.shape[1]))
    for column, (start, series) in zip(panels.T, averages.items(), strict=True):
        for key, label, color in (*labels, ("filter", outcome.name, MODEL)):
            for axes, curve in zip(column, series[key], strict=True):
                axes.plot(time, curve, color=color, lw=1.6, label=label)
        column[0].set_title(f"{start} start")
        _time(column[-1], time, unit)
    for axes, quantity in zip(panels[:, 0], NAMES, strict=True):
        axes.set_ylabel(f"{quantity} error [{getattr(case.system.units, quantity)}]")
    for row in panels:
        _logarithmic(row[0], outcome.first, row)
        row[1].grid(alpha=0.3)
    _legend_below(figure, panels[0, 0])
    figure.suptitle(
        f"{case.system.name}: rms error over {len(case.test.states)} unseen trajectories, mean of the last "
        f"{SMOOTHING} samples"
    )
    return figure


def time_axis(case: Case, sample: Tensor) -> tuple[Tensor, str]:
    """Return the times of samples, in hours where the system's unit is s and the arc is long."""
    time = sample * case.test.dt
    unit = case.system.units.time
    return (time / 3600, "h") if unit == "s" and float(time[-1]) > 7200 else (time, unit)


def _grid(case: Case) -> tuple[Figure, list[Any]]:
    """Return a figure with one panel a component, positions in the left column."""
    n = case.system.dof
    figure = Figure(figsize=(11, 2.4 * n + 1.2), layout="constrained")
    panels = figure.subplots(n, 2, sharex=True, squeeze=False)
    return figure, [*panels[:, 0], *panels[:, 1]]


def _label(case: Case, figure: Figure, grid: list[Any], axis: tuple[Tensor, str], prefix: str) -> None:
    n, units = case.system.dof, case.system.units
    for i, axes in enumerate(grid):
        name = case.system.components[i]
        text = f"{name} [{units.position}]" if i < n else f"{name} / m [{units.velocity}]"
        axes.set_ylabel(prefix + text)
        axes.grid(alpha=0.3)
    for last in (grid[n - 1], grid[-1]):
        _time(last, *axis)
    _legend_below(figure, grid[0])


def _columns(case: Case, *states: Tensor) -> list[Tensor]:
    """Return states, or errors, (T, D) with velocities in place of momenta."""
    return [torch.cat(blocks(x, case.system.inertia), dim=-1) for x in states]


def _member(outcome: Outcome) -> int:
    """Return the first trajectory that was not lost, or the first."""
    return int((outcome.result.status != 0).to(torch.int64).argmin())


def _updates(outcome: Outcome, b: int) -> Tensor:
    """Return the samples at which member b was measured."""
    return torch.nonzero(outcome.result.measured[b] > 0).flatten() + 1


def _frame(axes: Any, curves: list[Tensor], *, symmetric: bool) -> None:
    """Set the vertical limits to curves, (T,), with a margin; leave them where nothing is finite."""
    values = torch.cat([curve[curve.isfinite()] for curve in curves])
    if not len(values):
        return
    low, high = float(values.min()), float(values.max())
    if symmetric:
        high = max(abs(low), abs(high))
        low = -high
    margin = 0.08 * (high - low) or 1.0
    axes.set_ylim(low - margin, high + margin)


def _time(axes: Any, time: Tensor, unit: str) -> None:
    axes.set_xlabel(f"time [{unit}]")
    axes.set_xlim(0, float(time[-1]))
    axes.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 4, 5, 10]))


def _legend_below(figure: Figure, axes: Any) -> None:
    handles, labels = axes.get_legend_handles_labels()
    columns = 4 if figure.get_figwidth() > 9 else 2
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)


def _logarithmic(axes: Any, first: int, others: Any = ()) -> None:
    """Make the vertical axis logarithmic, scaled to the curves from their entry `first` on.

    Args:
        axes: with lines.
        first: entries before it may leave the frame: errors begin at zero from a true start.
        others: further axes that share the scale.
    """
    curves = [line for each in (axes, *others) for line in each.get_lines()]
    series = [torch.as_tensor(line.get_ydata()).double() for line in curves]
    values = torch.cat([each[min(first, len(each) - 1) :] for each in series])
    values = values[values.isfinite() & (values > 0)]
    axes.set_yscale("log")
    axes.grid(alpha=0.3)
    if not len(values):
        return
    low, high = float(values.min()) / 1.3, float(values.max()) * 1.3
    axes.set_ylim(low, high)
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 30 * low else (1.0,)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
