"""Table of the jobs of a sweep: overrides, training and scores."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import yaml
from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from ahnn.contents import read_whole
from ahnn.errors import UserError
from ahnn.evaluation.case import Who
from ahnn.evaluation.results import Results, load_results
from ahnn.evaluation.score_table import number
from ahnn.evaluation.titles import MODEL
from ahnn.labels import quantity

TRAINING = {"W": "window", "seconds": "seconds", "val loss": "val_loss"}
"""Columns of training information; losses over windows of different W are not comparable."""
QUANTITIES = ("position", "velocity", "energy")
SEED = "seed="
OF_SWEEPER = ("trial=", "hydra.sweep.subdir=")
WORSE = 10.0
"""Ratio of errors over whole trajectories from which a least loss is called misleading."""
PRUNED = Path(".hydra", "pruned")
"""Mark that the sweeper leaves in the folder of a pruned job."""


def sweep_table(folder: Path, jobs: list[Path]) -> Table:
    """Format the table of job folders: overrides, training, and the model's scores from the true start.

    Overrides common to all jobs are listed once, above the table.
    """
    asked = [_overrides(job) for job in jobs]
    common = [text for text in asked[0] if all(text in texts for texts in asked)]
    title = "\n".join((f"sweep {folder}", *(["all jobs: " + " ".join(common)] if common else [])))
    table = Table(title=Text(title, "bold"), title_justify="left", box=SIMPLE_HEAD)
    table.pad_edge, table.padding = False, (0, 1, 0, 0)
    table.add_column("job", no_wrap=True)
    table.add_column("overrides")
    found = [_results(job) for job in jobs]
    spaces = [results.space for results in found if results is not None]
    heads = [quantity(spaces[0], name)[0] for name in QUANTITIES] if spaces else QUANTITIES
    for head in (*TRAINING, *heads):
        table.add_column(head, justify="right", no_wrap=True)
    for job, texts, results in zip(jobs, asked, found, strict=True):
        values = None if results is None else _values(results)
        missing = ["-"] * (len(TRAINING) + len(QUANTITIES) - 1)
        pruned = values is None and (job / PRUNED).exists()
        cells = [*missing, "pruned" if pruned else "no scores"] if values is None else values
        own = OverrideCell([rounded(text) for text in texts if text not in common])
        table.add_row(job.name, own, *cells, style="red" if values is None and not pruned else None)
    units = {tuple(quantity(space, name)[1] for name in QUANTITIES) for space in spaces}
    known = f", in {', '.join(*units)}" if len(units) == 1 else ""
    about = "W: steps in the loss; losses for different W are not comparable. Scores: true start"
    table.caption = f"{about}{known}."
    if any(text.startswith(SEED) for texts in asked for text in texts if text not in common):
        table.caption += f"\nMeans and spreads over seeds: python -m ahnn.report {folder}"
    if remark := contradiction({job.name: one for job, one in zip(jobs, found, strict=True) if one}):
        table.caption += f"\n{remark}"
    table.caption_justify = "left"
    return table


def contradiction(results: Mapping[str, Results]) -> str | None:
    """Return a remark if the job of the least validation loss predicts far worse than another, or None."""
    scored = [
        (float(one.training["val_loss"]), row.scores.position, name, one.training.get("window"))
        for name, one in results.items()
        if one.training.get("val_loss") is not None and (row := one.row(Who(MODEL, "true"))) is not None
    ]
    if len({window for *_, window in scored}) != 1:
        return None
    least, nearest = min(scored), min(scored, key=lambda job: job[1])
    if least[1] <= WORSE * nearest[1]:
        return None
    return (
        f"Job {least[2]} has the least val loss, but {least[1] / nearest[1]:.2g} times the error of job "
        f"{nearest[2]} over whole trajectories."
    )


class OverrideCell:
    """Overrides in a table cell, broken between overrides, and after `=` where one is wider than the cell."""

    def __init__(self, texts: list[str]) -> None:
        self.texts = texts

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        """Return the widths of the widest override and of all in one line."""
        each = [len(text) for text in self.texts] or [0]
        return Measurement(max(each), sum(each) + len(each) - 1).with_maximum(options.max_width)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the text."""
        wide = any(len(text) > options.max_width for text in self.texts)
        cut = [
            text.replace("=", "=\n  ", 1) if len(text) > options.max_width else text for text in self.texts
        ]
        yield Text(("\n" if wide else " ").join(cut), overflow="fold")


def rounded(override: str) -> str:
    """Return an override with its value, if it is a fraction, rounded to 4 digits."""
    key, _, value = override.partition("=")
    try:
        short = f"{float(value):.4g}"
    except ValueError:
        return override
    whole = value.lstrip("+-").isdigit()
    return override if whole or len(short) >= len(value) else f"{key}={short}"


def _results(job: Path) -> Results | None:
    """Return the results of a job, or None."""
    try:
        return load_results(job)
    except UserError:
        return None


def _values(results: Results) -> list[str] | None:
    """Return the cells of a job, or None without a score."""
    row = results.row(Who(MODEL, "true"))
    if row is None:
        return None
    training = [results.training.get(key) for key in TRAINING.values()]
    numbers = [str(x) if isinstance(x, int) else "-" if x is None else number(float(x)) for x in training]
    return [*numbers, *(number(getattr(row.scores, name)) for name in QUANTITIES)]


def _overrides(job: Path) -> list[str]:
    """Return the overrides of a job, without those that the sweeper adds."""
    try:
        found = yaml.safe_load(read_whole(job / ".hydra" / "overrides.yaml").decode("utf-8", "replace"))
    except (OSError, yaml.YAMLError):
        return []
    texts = map(str, found if isinstance(found, list) else [])
    return [text for text in texts if not text.startswith(OF_SWEEPER)]
