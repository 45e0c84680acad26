"""The results as a table for the terminal."""

from __future__ import annotations

from collections.abc import Iterable

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from ahnn.evaluation.case import Row
from ahnn.systems import System

WIDTH = 110
"""Columns of a table that goes to no terminal."""


def results_table(title: str, rows: Iterable[Row], system: System) -> Table:
    """Return the table of an evaluation, floors dimmed, units in the head."""
    rows, units = list(rows), system.units
    table = Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("prediction", no_wrap=True)
    table.add_column("start", no_wrap=True)
    for quantity in ("position", "velocity", "energy"):
        table.add_column(f"{quantity}\n\\[{getattr(units, quantity)}]", justify="right", no_wrap=True)
    for quantity in ("position", "velocity"):
        table.add_column(f"pooled\n{quantity}", justify="right", no_wrap=True)
    for row in rows:
        s = row.scores
        values = (s.position, s.velocity, s.energy, s.position_pooled, s.velocity_pooled)
        table.add_row(row.name, row.start, *map(number, values), style="dim" if row.floor else None)
    explanation = (
        "RMSE over unseen trajectories: mean over trajectories of the rms vector norm;",
        "pooled: over trajectories, times and components.",
    )
    remarks = [f"{row.name}, {row.start} start: {row.note}" for row in rows if row.note]
    table.caption = "\n".join((*explanation, *remarks))
    table.caption_justify = "left"
    return table


def show(table: Table) -> None:
    """Write a table to standard output, unwrapped where that is a file or a pipe."""
    console = Console()
    Console(width=console.width if console.is_terminal else WIDTH).print(table)


def number(value: float) -> str:
    """Return a number with three digits, in the shorter of the two notations."""
    return f"{value:.3g}" if value == 0 or 1e-2 <= abs(value) < 1e4 else f"{value:.2e}"
