"""All scores of a collection as one CSV table, with one row per model, start, filter and quantity."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator

from ahnn import labels
from ahnn.evaluation.titles import MODEL
from ahnn_plugins.report.collection import Collection
from ahnn_plugins.report.overviews import floors
from ahnn_plugins.report.scores import QUANTITIES, Board, Measure, board, sample

COLUMNS = (
    "system",
    "model",
    "process",
    "estimator",
    "start",
    "span",
    "quantity",
    "unit",
    "runs",
    "mean",
    "standard_deviation",
    "smallest",
    "largest",
    "floor",
    "paper",
    "paper_doubt",
)
FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""Initial characters of texts that a spreadsheet would evaluate."""


def scores_csv(collection: Collection) -> str:
    """Format the table, with numbers in physical units and full precision."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for system in collection.systems():
        writer.writerows([_cell(value) for value in row] for row in _rows(board(collection, system)))
    return text.getvalue()


def _rows(scores: Board) -> Iterator[tuple[str | float | None, ...]]:
    space = scores.entries[0].results.space
    for model, entries in scores.groups.items():
        for who in dict.fromkeys(r.who for e in entries for r in e.results.rows if not r.who.floor):
            for quantity in QUANTITIES:
                found = sample(entries, who, quantity)
                if not found.values:
                    continue
                floor = floors(entries, who, quantity)
                filters = who.estimator == scores.estimator and who.estimator is not None
                of_paper = who.process == MODEL and who.span == "whole" and (filters or who.estimator is None)
                said = scores.printed(Measure(model, quantity, who.start, filters)) if of_paper else None
                yield (
                    *(scores.system, model, who.process, who.estimator, who.start, who.span),
                    *(*labels.quantity(space, quantity), len(found.values), found.mean, found.spread),
                    *(min(found.values), max(found.values), floor.mean if floor.values else None),
                    *((said.value, said.doubt) if said else (None, "")),
                )


def _cell(value: str | float | None) -> str:
    """Return a cell; texts that a spreadsheet would treat as formulas are escaped."""
    if value is None:
        return ""
    if isinstance(value, str):
        return f"'{value}" if value.startswith(FORMULA) else value
    return repr(value)
