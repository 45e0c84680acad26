"""Estimated and predicted states with bands along one trajectory, compared with the truth."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.labels import components
from ahnn_plugins.report.drawing import Drawing, Panel, Series
from ahnn_plugins.report.figures.curves import curve
from ahnn_plugins.report.figures.models import ORDER
from ahnn_plugins.report.figures.reading import Kept, Teeth, velocities
from ahnn_plugins.report.figures.task import Task, time_label
from ahnn_plugins.report.scores import plain_filter

WIDE = 3.0
"""Half-width of the bands, in standard deviations."""
PAPER = {"mass_spring": "6", "molniya": "8"}
ROOM = 1.08
"""Size of the frame relative to its content."""


def state_drawings(task: Task) -> list[Drawing]:
    """Plot filter estimates and errors, and prediction errors with their bands.

    The filter is that of AHNN5, as in the paper, or otherwise the most accurate one.
    """
    found = []
    run = _filtered(task)
    if run is not None:
        start = "perturbed" if "perturbed" in run.teeth else next(iter(run.teeth))
        found += [_states(task, run, run.teeth[start], start), _errors(task, run, run.teeth[start], start)]
    return found + [_band(task, each) for each in task.drawn if each.deviations is not None]


def _filtered(task: Task) -> Kept | None:
    runs = [run for several in task.models.values() for run in several if run.teeth]
    proposed = [run for run in runs if run.entry.model.upper() == ORDER[-1]]
    return min(proposed[:1] or runs, key=_score, default=None)


def _score(run: Kept) -> float:
    """Return the smallest position error of a filter from any start; infinite if there is no score."""
    own = plain_filter([run.entry])
    rows = [row for row in run.entry.results.rows if row.who.estimator == own and not row.who.floor]
    return min((row.scores.position for row in rows if row.scores.position < torch.inf), default=torch.inf)


def _states(task: Task, run: Kept, teeth: Teeth, start: str) -> Drawing:
    panels = []
    for i, label in enumerate(components(run.space)):
        truth, mean, wide = teeth.truth[:, i], teeth.mean[:, i], WIDE * teeth.deviation[:, i]
        name, slot = f"{run.entry.model} + {run.filter}, ±{WIDE:g}σ", run.slot
        band = mean - wide, mean + wide
        series = (
            curve(name, teeth.time, mean, role="filter", slot=slot, band=band),
            curve(run.known, teeth.time, truth, role="truth"),
            _marks(teeth, mean),
        )
        panels.append(Panel(series, time_label(run), label, limits=_frame(truth)))
    number = PAPER.get(task.system)
    same = number and start == "perturbed" and run.entry.model.upper() == ORDER[-1]
    paper = f" (as in figure {number} of the paper)" if same else ""
    title = f"state estimated by {run.entry.model} + {run.filter}, {start} start{paper}"
    caption = (
        f"{_which(run, teeth)}, before and after every update; its band is ±{WIDE:g} standard deviations."
    )
    return task.drawing("ukf_state", title, caption, panels)


def _errors(task: Task, run: Kept, teeth: Teeth, start: str) -> Drawing:
    panels = []
    settled = teeth.updates.cumsum(0) > 0
    for i, label in enumerate(components(run.space)):
        error, wide = (teeth.mean - teeth.truth)[:, i], WIDE * teeth.deviation[:, i]
        name, band = f"{run.entry.model} + {run.filter}: estimate - truth, ±{WIDE:g}σ", (-wide, wide)
        main = curve(name, teeth.time, error, role="filter", slot=run.slot, band=band)
        series = (main, _marks(teeth, error))
        shown = torch.cat((-wide[settled], wide[settled], error[settled]))
        panels.append(Panel(series, time_label(run), f"error of {label}", limits=_frame(shown)))
    caption = (
        f"{_which(run, teeth)}: its error and its band. The axis is scaled to the values after the first "
        "update."
    )
    title = f"error of {run.entry.model} + {run.filter} in its band, {start} start"
    return task.drawing("ukf_error", title, caption, panels)


def _band(task: Task, run: Kept) -> Drawing:
    """Plot the error of a prediction with the band of the parameter covariance."""
    assert run.deviations is not None
    inertia, panels = run.space.divisor, []
    error = velocities(run.first["true"], inertia) - velocities(run.path, inertia)
    deviations = velocities(run.deviations, inertia)
    for i, label in enumerate(components(run.space)):
        wide = WIDE * deviations[:, i]
        name, band = f"{run.entry.model}: error, ±{WIDE:g}σ", (-wide, wide)
        series = (curve(name, run.time, error[:, i], slot=run.slot, band=band),)
        panels.append(Panel(series, time_label(run), f"error of {label}"))
    title = f"error of {run.entry.model} in the band of its prediction, true start"
    caption = f"{run.entry.folder.name}, first test trajectory; band: uncertainty of learned parameters."
    return task.drawing(f"band_{run.slot}", title, caption, panels)


def _marks(teeth: Teeth, values: Tensor) -> Series:
    """Return the estimates right after an update."""
    return Series("updates", teeth.time[teeth.updates], values[teeth.updates], role="measurement")


def _frame(values: Tensor) -> tuple[float, float] | None:
    """Return limits of finite values, with a margin."""
    values = values[values.isfinite()]
    if not len(values) or float(values.max()) <= float(values.min()):
        return None
    low, high = float(values.min()), float(values.max())
    margin = (ROOM - 1) * (high - low)
    return low - margin, high + margin


def _which(run: Kept, teeth: Teeth) -> str:
    return f"Test trajectory {teeth.member + 1} of {run.entry.folder.name}"
