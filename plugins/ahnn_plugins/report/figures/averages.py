"""Moving averages of errors over all test trajectories, with and without a filter."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

from ahnn.evaluation.trajectory_figures import SMOOTHING
from ahnn.labels import components, quantity
from ahnn.metrics import moving_average
from ahnn_plugins.report.drawing import Drawing, Panel, Series
from ahnn_plugins.report.figures.curves import curve
from ahnn_plugins.report.figures.reading import STARTS, Kept
from ahnn_plugins.report.figures.task import Task, over_seeds, time_label

PAPER = {
    ("mass_spring", False): "9",
    ("mass_spring", True): "10",
    ("molniya", False): "11",
    ("molniya", True): "12",
}
"""Figures of the paper, by system and by use of a filter."""


def average_drawings(task: Task) -> list[Drawing]:
    """Plot moving averages of errors from every start, with and without a filter, also by component.

    For a single run, the unsmoothed errors are also plotted.
    """
    found = []
    for prefix in ("", "ukf/"):
        for start in STARTS:
            if any(f"{prefix}{start}" in run.rms for run in task.drawn):
                found.append(_norms(task, prefix, start))
                # The paper shows components only for the orbit, from one start.
                if task.lead.space.dof > 1 and start == ("perturbed" if prefix else "true"):
                    found.append(_components(task, prefix, start))
    runs = [run for runs in task.models.values() for run in runs]
    if len(runs) == 1 and task.lead.start:
        found.insert(0, _unsmoothed(task, task.lead.start))
    return found


def _norms(task: Task, prefix: str, start: str) -> Drawing:
    dof = task.lead.space.dof
    panels = [
        _panel(task, f"{prefix}{start}", 2 * dof + block, f"{name} error [{unit}]", smoothed)
        for block, (name, unit) in enumerate(_blocks(task.lead))
    ]
    name = f"averages_{'ukf_' if prefix else ''}{start}"
    title, caption = _title(task, prefix, start, dof == 1), _caption(task, start)
    return task.drawing(name, title, caption, _filled(panels), spread=task.spread())


def _components(task: Task, prefix: str, start: str) -> Drawing:
    labels = [f"error of {label}" for label in components(task.lead.space)]
    panels = [_panel(task, f"{prefix}{start}", i, label, smoothed) for i, label in enumerate(labels)]
    name = f"averages_{'ukf_' if prefix else ''}{start}_components"
    title = f"{_title(task, prefix, start, True)}, by component"
    return task.drawing(
        name, title, _caption(task, start, "component"), _filled(panels), spread=task.spread()
    )


def _unsmoothed(task: Task, start: str) -> Drawing:
    dof = task.lead.space.dof
    panels = [
        _panel(task, start, 2 * dof + block, f"{name} error [{unit}]", lambda series: series)
        for block, (name, unit) in enumerate(_blocks(task.lead))
    ]
    over = _trajectories(task.lead.members)
    caption = f"Root mean square over {over} of the norm of the error, at every sample."
    return task.drawing(f"error_{start}", f"error over time, {start} start", caption, _filled(panels))


def _filled(panels: list[Panel]) -> list[Panel]:
    """Return the panels with values: velocities that were not measured have no errors."""
    found = [panel for panel in panels if any(bool(s.y.isfinite().any()) for s in panel.series)]
    return found or panels[:1]


def smoothed(series: Tensor) -> Tensor:
    """Return the moving mean over the last 240 values, (T,) (paper, appendix)."""
    return moving_average(series, SMOOTHING)


def _panel(task: Task, key: str, column: int, label: str, smooth: Callable[[Tensor], Tensor]) -> Panel:
    lead, series = task.lead, []
    role = "filter" if key.startswith("ukf/") else "model"
    for model, runs in task.models.items():
        there = [smooth(run.rms[key][:, column]) for run in runs if key in run.rms]
        if there:
            mean, band = over_seeds(there)
            name = f"{model} + {runs[0].filter}" if role == "filter" else model
            series.append(curve(name, lead.time, mean, role=role, slot=runs[0].slot, band=band, log=True))
    series += _floor(task, key, column, smooth)
    return Panel(tuple(series), time_label(lead), label, log=True)


def _floor(task: Task, key: str, column: int, smooth: Callable[[Tensor], Tensor]) -> list[Series]:
    """Return the floor; with a filter only averaged norms are available."""
    prefix, _, start = key.rpartition("/")
    block = column - 2 * task.lead.space.dof
    for run in task.drawn:
        floor = run.rms.get(f"floor_{start}") if not prefix else None
        values = None if floor is None else smooth(floor[:, column])
        if prefix and block >= 0 and f"{prefix}/floor_{start}" in run.averages:
            values = run.averages[f"{prefix}/floor_{start}"][block]
        if values is not None:
            return [
                curve(
                    f"floor + {run.filter}" if prefix else "floor", run.time, values, role="floor", log=True
                )
            ]
    return []


def _blocks(run: Kept) -> tuple[tuple[str, str], tuple[str, str]]:
    return quantity(run.space, "position"), quantity(run.space, "velocity")


def _title(task: Task, prefix: str, start: str, in_paper: bool) -> str:
    number = PAPER.get((task.system, bool(prefix))) if in_paper else None
    paper = f" (as in figure {number} of the paper)" if number and start != "fitted" else ""
    setting = f"with {task.lead.filter}" if prefix else "without measurements"
    return f"moving average of the error {setting}, {start} start{paper}"


def _caption(task: Task, start: str, what: str = "norm") -> str:
    lead = task.lead
    count, over = min(SMOOTHING, len(lead.time)), _trajectories(lead.members)
    return (
        f"Mean of the last {count} samples of the root mean square over {over} of the {what} of the error, "
        f"{start} start."
    )


def _trajectories(count: int) -> str:
    return f"{count} test {'trajectory' if count == 1 else 'trajectories'}"
