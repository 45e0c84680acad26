"""Ranking of models and of windows, with significance from the spread over seeds."""

from __future__ import annotations

import math
from itertools import combinations, pairwise, product
from typing import NamedTuple

from ahnn import labels
from ahnn.evaluation.case import Start
from ahnn.labels import headed
from ahnn_plugins.report.collection import Entry
from ahnn_plugins.report.grid import NONE, Cell, Grid, Head, Line, interval, mean_and_spread
from ahnn_plugins.report.paper import MODELS
from ahnn_plugins.report.score_samples import Sample, ratio
from ahnn_plugins.report.scores import QUANTITIES, Board, Measure

STARTS: tuple[Start, ...] = ("true", "perturbed", "fitted")
COLUMNS = [
    Measure("", quantity, start, with_filter)
    for with_filter, start, quantity in product((False, True), STARTS[:2], QUANTITIES[:2])
]
"""Columns of the ablation, for the model of each row."""


class Order(NamedTuple):
    """Models by their error, the lowest first.

    Attributes:
        models: models in the order of the geometric means over seeds.
        decided: whether each is significantly below the next one.
    """

    models: tuple[str, ...]
    decided: tuple[bool, ...]

    def __str__(self) -> str:
        signs = [" < " if decided else " ~ " for decided in self.decided]
        return "".join(m + sign for m, sign in zip(self.models, [*signs, ""], strict=True))


def ordered(samples: dict[str, Sample], confidence: float) -> Order:
    """Rank the models that have scores, with undefined means last."""
    there = {model: sample for model, sample in samples.items() if sample.values}
    models = sorted(there, key=lambda m: math.inf if math.isnan(there[m].typical) else there[m].typical)
    decided = [ratio(there[a], there[b], confidence).high < 1 for a, b in pairwise(models)]
    return Order(tuple(models), tuple(decided))


def agreement(
    samples: dict[str, Sample], printed: dict[str, float], confidence: float
) -> tuple[int, int, int]:
    """Return the numbers of pairs decided as in the paper, against it, and undecided."""
    found = {1: 0, -1: 0, 0: 0}
    known = {model.lower(): value for model, value in printed.items()}
    shared = [model for model in samples if samples[model].values and model.lower() in known]
    for a, b in combinations(shared, 2):
        between = ratio(samples[a], samples[b], confidence)
        decided = int(between.high < 1) - int(between.low > 1)
        said = 1 if known[a.lower()] < known[b.lower()] else -1
        found[decided * said] += 1
    return found[1], found[-1], found[0]


def order_table(board: Board, confidence: float) -> Grid | None:
    """Build the ranking of the models by each error; None for a single model.

    Columns about the paper are omitted for a system that it does not treat.
    """
    lines = []
    for with_filter, start, quantity in product((False, True), STARTS, QUANTITIES):
        measures = {model: Measure(model, quantity, start, with_filter) for model in board.groups}
        samples = {model: board.sample(measure) for model, measure in measures.items()}
        if sum(bool(sample.values) for sample in samples.values()) < 2:
            continue
        places = {model: board.printed(Measure(model, quantity, start, with_filter)) for model in MODELS}
        said = {model: place.value for model, place in places.items() if place is not None}
        pairs = agreement(samples, said, confidence)
        cells = [
            Cell(str(ordered(samples, confidence)), "words"),
            Cell(" < ".join(sorted(said, key=lambda model: said[model])) or NONE, "words"),
            *(Cell(str(count) if said else NONE) for count in pairs),
        ]
        called, _ = labels.quantity(board.entries[0].results.space, quantity)
        name = f"{called}, {start} start" + (", filter" if with_filter else "")
        lines.append(Line(name, tuple(cells)))
    if not lines:
        return None
    heads: tuple[tuple[Head, ...], ...] = (
        (Head(""), Head("ours"), Head("paper"), Head("pairs of models", 3)),
        (Head("Error"), Head(""), Head(""), Head("as paper"), Head("reverse"), Head("open")),
    )
    if all(cell.text == NONE for line in lines for cell in line.cells[1:]):
        heads, lines = ((Head("Error"), Head("order")),), [Line(line.name, line.cells[:1]) for line in lines]
    caption = (
        f"Lowest error first, by the geometric mean over seeds. A < B: decided, the {confidence:.0%} "
        "interval of the ratio lies below one (Welch's test on the logarithms of the scores, each pair by "
        "itself); A ~ B: the seeds do not decide."
    )
    return Grid(f"order_{board.system}", "Order of the models.", caption, heads, tuple(lines))


def ablation_table(board: Board, confidence: float) -> Grid | None:
    """Build the table of errors by window W, grouped by assumptions; None without two windows to compare."""
    lines = []
    for assumes, windows in sorted(windows_of(board).items()):
        if len(windows) > 1:
            lines.append(Line(assumes or "assumptions not known"))
            lines += [
                Line(f"W = {w}", _window(board, windows[w], windows[min(windows)], confidence))
                for w in sorted(windows)
            ]
    if not lines:
        return None
    space = board.entries[0].results.space
    names = [
        f"{headed(space, m.quantity)}, {m.start} start" + (", filter" if m.filtered else "") for m in COLUMNS
    ]
    caption = (
        "Mean ± standard deviation over runs; in parentheses the factor to the smallest window with its "
        f"{confidence:.0%} interval. HNN is the window of one step."
    )
    heads = ((Head("Window"), Head("runs"), *map(Head, names)),)
    return Grid(f"window_{board.system}", "Ablation of the window W.", caption, heads, tuple(lines))


def windows_of(board: Board) -> dict[str, dict[int, list[Entry]]]:
    """Group the runs by model assumptions and window."""
    kinds: dict[str, dict[int, list[Entry]]] = {}
    for entry in board.entries:
        window = entry.results.training.get("window")
        if isinstance(window, int):
            kinds.setdefault(entry.results.assumes, {}).setdefault(window, []).append(entry)
    return kinds


def _window(board: Board, entries: list[Entry], first: list[Entry], confidence: float) -> tuple[Cell, ...]:
    """Return the number of runs and the errors of a window, with their ratios to those of the first."""
    cells = [Cell(str(len(entries)))]
    for measure in COLUMNS:
        own, base = board.sample_of(entries, measure), board.sample_of(first, measure)
        compares = entries is not first and own.values and base.values
        factor = f" (× {interval(ratio(own, base, confidence))})" if compares else ""
        cells.append(Cell(mean_and_spread(own) + factor))
    return tuple(cells)
