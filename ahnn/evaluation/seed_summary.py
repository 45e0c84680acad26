"""Table of mean and spread over seeds for several models, 80 characters wide."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Iterator
from pathlib import Path
from statistics import fmean, stdev

from ahnn.errors import UserError
from ahnn.evaluation.case import Row
from ahnn.evaluation.results import Results, load_results
from ahnn.evaluation.score_table import number
from ahnn.evaluation.terminal import WIDTH
from ahnn.evaluation.titles import MODEL, estimator_title
from ahnn.labels import headed

COLUMNS = [(start, quantity) for start in ("true", "perturbed") for quantity in ("position", "velocity")]
CELL = 16


def summary(folder: Path, names: Iterable[str]) -> str:
    """Format the table of the runs in a folder, with the command for a full report.

    Args:
        folder: folder that contains the run folders.
        names: names of the run folders, LABEL_SEED; those without results are listed below the table.
    """
    found, missing = [], []
    for name in names:
        try:
            found.append(load_results(folder / name))
        except UserError:
            missing.append(name)
    lines = list(seeds_table(found)) if found else []
    if missing:
        lines += textwrap.wrap(f"without results yet: {', '.join(missing)}", WIDTH)
    return "\n".join([*lines, f"report: python -m ahnn.report {folder}"])


def seeds_table(runs: list[Results]) -> Iterator[str]:
    """Yield the table lines: for each estimator, mean and relative spread of each model, then the floor."""
    models = list(dict.fromkeys(run.label for run in runs))
    width = max(5, *map(len, models)) + 2
    yield " " * width + f"{'true start':>{2 * CELL}}{'perturbed start':>{2 * CELL}}"
    heads = [headed(runs[0].space, quantity) for _, quantity in COLUMNS]
    yield " " * width + "".join(f"{head:>{CELL}}" for head in heads)
    estimators = dict.fromkeys(
        row.who.estimator for run in runs for row in run.rows if row.who.process == MODEL
    )
    for estimator in estimators:
        yield "no measurements" if estimator is None else estimator_title(estimator)
        for model in models:
            cells = (scores([run for run in runs if run.label == model], estimator, *c) for c in COLUMNS)
            yield f"  {model}".ljust(width) + "".join(f"{cell(values):>{CELL}}" for values in cells)
        floors = (scores(runs, estimator, *column, floor=True) for column in COLUMNS)
        yield "  floor".ljust(width) + "".join(f"{cell(values[:1]):>{CELL}}" for values in floors)
    yield from textwrap.wrap(
        "RMSE over unseen trajectories, mean over trajectories of the rms vector norm: mean over the "
        "seeds ± standard deviation in percent. floor: score of perfect knowledge.",
        WIDTH,
    )


def scores(
    runs: list[Results], estimator: str | None, start: str, quantity: str, *, floor: bool = False
) -> list[float]:
    """Return one score per run, that of its model or its floor, over full trajectories."""
    return [
        getattr(row.scores, quantity)
        for run in runs
        for row in run.rows
        if is_of(row, estimator, start, floor=floor)
    ]


def is_of(row: Row, estimator: str | None, start: str, *, floor: bool) -> bool:
    """Return whether a row is of the model, or a floor, for an estimator and start over full trajectories."""
    who = row.who
    side = who.floor if floor else who.process == MODEL and not who.floor
    return bool(side) and (who.estimator, who.start, who.span) == (estimator, start, "whole")


def cell(values: list[float]) -> str:
    """Format mean and relative spread; a single value has no spread."""
    if not values:
        return "-"
    mean = fmean(values)
    if len(values) < 2 or not math.isfinite(mean) or mean == 0:
        return number(mean)
    return f"{number(mean)} ±{100 * stdev(values) / mean:.0f}%"
