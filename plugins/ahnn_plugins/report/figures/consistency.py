"""NEES of the filters over time, with the band of a consistent filter."""

from __future__ import annotations

import torch

from ahnn.estimation.consistency import band
from ahnn_plugins.report.drawing import Drawing, Panel, Series
from ahnn_plugins.report.figures.curves import curve
from ahnn_plugins.report.figures.reading import STARTS
from ahnn_plugins.report.figures.task import Task, over_seeds, time_label


def consistency_drawings(task: Task) -> list[Drawing]:
    """Plot the NEES of the filters from every start, in stacked panels."""
    starts = [start for start in STARTS if any(start in run.nees for run in task.drawn)]
    if not starts:
        return []
    caption = (
        f"Normalised estimation error squared, mean over {task.lead.members} test trajectories. Above its "
        f"band the filter is overconfident, below it too cautious."
    )
    panels = [_panel(task, start) for start in starts]
    return [task.drawing("nees", "NEES of the filters over time", caption, panels, spread=task.spread())]


def _panel(task: Task, start: str) -> Panel:
    lead = task.lead
    size = 2 * lead.space.dof
    low, high = (torch.full_like(lead.time[[0, -1]], limit) for limit in band(size, lead.members))
    ends, level = lead.time[[0, -1]], torch.full_like(low, float(size))
    series = [Series("consistent: 95 % band", ends, level, role="floor", low=low, high=high)]
    for model, runs in task.models.items():
        there = [run.nees[start] for run in runs if start in run.nees]
        if there:
            mean, seeds = over_seeds(there)
            series.append(
                curve(
                    f"{model} + {runs[0].filter}",
                    lead.time,
                    mean,
                    role="filter",
                    slot=runs[0].slot,
                    band=seeds,
                    log=True,
                )
            )
    return Panel(tuple(series), time_label(lead), f"mean NEES, {start} start", log=True)
