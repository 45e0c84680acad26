"""General tables: all scores, prior knowledge and noise, and training costs."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ahnn.evaluation.case import Who
from ahnn.evaluation.score_table import about_fitted
from ahnn.evaluation.titles import MODEL, title
from ahnn.labels import headed
from ahnn_plugins.report.collection import Entry
from ahnn_plugins.report.grid import NONE, Cell, Grid, Head, Line, mean_and_spread, shown
from ahnn_plugins.report.score_samples import Sample
from ahnn_plugins.report.scores import QUANTITIES, Board, floor_of, measured, sample
from ahnn_plugins.report.settings import loss_of, noise_of, values_of


def score_table(board: Board) -> Grid:
    """Build the table of all scores of all models, with floors."""
    lines, quantities = [], scored(board.entries)
    for model, entries in board.groups.items():
        lines.append(Line(model))
        for who in dict.fromkeys(r.who for e in entries for r in e.results.rows if not r.who.floor):
            count = sum(entry.results.row(who) is not None for entry in entries)
            cells = [Cell(str(count))]
            for quantity in quantities:
                floor = floors(entries, who, quantity)
                cells += [
                    Cell(mean_and_spread(sample(entries, who, quantity))),
                    Cell(shown(floor.mean if floor.values else None), "quiet"),
                ]
            lines.append(Line(described(who, model), tuple(cells)))
    names = [headed(board.entries[0].results.space, q) for q in quantities]
    heads = (
        (Head(""), Head(""), *(Head(name, 2) for name in names)),
        (Head("Prediction"), Head("runs"), *((Head("model"), Head("floor")) * len(names))),
    )
    caption = (
        "States: mean over trajectories of the rms vector norm; mean ± standard deviation over runs. Floor: "
        "score of the exact equations. Settled: after the first update."
    )
    if about := about_fitted(row for entry in board.entries for row in entry.results.rows):
        caption = f"{caption} {about[0].upper()}{about[1:]}"
    return Grid(f"scores_{board.system}", "All scores.", caption, heads, tuple(lines))


def scored(entries: Iterable[Entry]) -> list[str]:
    """Return the quantities with a score in any row: velocities may be unmeasured, energies unknown."""
    rows = [row.scores for entry in entries for row in entry.results.rows]
    return [q for q in QUANTITIES if measured(getattr(scores, q) for scores in rows).values]


def floors(entries: Iterable[Entry], who: Who, quantity: str) -> Sample:
    """Return the floors of a row, over runs."""
    found = []
    for entry in entries:
        same = [r for r in entry.results.rows if r.who.floor and r.who[1:4] == who[1:4]]
        row = same[0] if same else None
        if row is None and who.span == "whole":
            row = floor_of(entry, who.start, who.estimator is not None, who.estimator)
        value = None if row is None else getattr(row.scores, quantity)
        found += [] if value is None else [value]
    return measured(found)


def described(who: Who, model: str) -> str:
    """Describe predictor and start, without the model's name, which heads the section."""
    name = title(who, model)
    own = name.removeprefix(model).removeprefix(" + ") if who.process == MODEL else name
    span = ", settled" if who.span == "settled" else ""
    return f"{own or 'no measurements'}, {who.start} start{span}"


def ladder_table(board: Board) -> Grid | None:
    """Return the errors by prior knowledge, loss and noise; None if these are equal for all runs."""
    steps: dict[tuple[str, str, str], list[Entry]] = {}
    for entry in board.entries:
        content = values_of(entry.folder)
        key = (
            entry.results.assumes or NONE,
            loss_of(content) or NONE,
            noise_of(content) if content else NONE,
        )
        steps.setdefault(key, []).append(entry)
    if len(steps) < 2:
        return None
    lines, quantities = [], scored(board.entries)
    for (assumes, loss, noise), entries in steps.items():
        start = "true" if any(e.results.row(Who(MODEL, "true")) for e in entries) else "fitted"
        models = ", ".join(dict.fromkeys(entry.model for entry in entries))
        cells = [Cell(text, "words") for text in (loss, noise, models)]
        cells += [Cell(str(len(entries))), Cell(start, "words")]
        cells += [Cell(mean_and_spread(sample(entries, Who(MODEL, start), q))) for q in quantities]
        lines.append(Line(assumes, tuple(cells)))
    names = ("loss", "noise of the data", "models", "runs", "start")
    heads = (
        (
            Head("Prior knowledge"),
            *map(Head, names),
            *(Head(headed(board.entries[0].results.space, q)) for q in quantities),
        ),
    )
    caption = "Without measurements; mean ± standard deviation over the runs that share the first columns."
    name = f"knowledge_{board.system}"
    return Grid(name, "Prior knowledge, loss and noise.", caption, heads, tuple(lines))


def cost_table(board: Board) -> Grid:
    """Build the table of training costs by model."""
    lines = []
    for model, entries in board.groups.items():
        count = [Cell(str(len(entries)))]
        lines.append(Line(model, (*count, *(_numbers(entries, key) for key in COSTS), _threads(entries))))
    heads = ((Head("Model"), Head("runs"), *map(Head, COSTS.values()), Head("threads")),)
    caption = "Mean ± standard deviation over runs; seconds on the machine that trained."
    return Grid(f"cost_{board.system}", "Cost.", caption, heads, tuple(lines))


COSTS = {
    "seconds": "training [s]",
    "steps": "optimiser steps",
    "parameters": "parameters",
    "window": "window W",
    "val_loss": "validation loss",
}
"""Training information, with column headings."""


def number(values: dict[str, Any], key: str) -> float | None:
    """Return a number from a file; None for other values or overflow."""
    value = values.get(key)
    if isinstance(value, bool) or not isinstance(value, float | int):
        return None
    return float(value) if isinstance(value, float) or abs(value) < 2**1023 else None


def _numbers(entries: list[Entry], key: str) -> Cell:
    values = [number(entry.results.training, key) for entry in entries]
    known = Sample(tuple(value for value in values if value is not None))
    if known.values and len({*known.values}) == 1 and known.values[0].is_integer():
        return Cell(f"{known.values[0]:.0f}")
    return Cell(mean_and_spread(known))


def _threads(entries: list[Entry]) -> Cell:
    known = {str(e.results.about["threads"])[:9] for e in entries if "threads" in e.results.about}
    return Cell(", ".join(sorted(known)) or NONE)
