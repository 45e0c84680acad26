"""Remarks on runs: missing results and differences."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ahnn.evaluation.titles import MODEL
from ahnn_plugins.report.collection import PREDICTIONS, Entry
from ahnn_plugins.report.paper import MODELS
from ahnn_plugins.report.paper_tables import LAYOUTS, is_of_paper
from ahnn_plugins.report.scores import Board

SAME = 1e-6
"""Relative difference of floors up to which runs count as tested on the same trajectories."""


def remarks(board: Board) -> list[str]:
    """Return remarks on missing runs of a system, and on differences between runs."""
    return [
        *_missing(board),
        *_seeds(board),
        *_filters(board),
        *_unequal(board),
        *_floors(board),
        *_lost(board),
    ]


def unfinished(folders: tuple[Path, ...]) -> list[str]:
    """Return a remark on folders without results."""
    if not folders:
        return []
    names = ", ".join(str(folder) for folder in folders[:10]) + (", ..." if len(folders) > 10 else "")
    return [f"{len(folders)} runs have no results, and are not in this report: {names}."]


def _missing(board: Board) -> Iterator[str]:
    if not is_of_paper(board):
        if board.system in LAYOUTS and any(model in MODELS for model in board.groups):
            yield "The units differ from those of the paper, whose numbers are omitted."
        return
    missing = [model for model in MODELS if model not in board.groups]
    if missing and len(board.entries) > 1:
        yield f"No runs of {', '.join(missing)}: their cells are empty."


def _seeds(board: Board) -> Iterator[str]:
    counts = {model: len(entries) for model, entries in board.groups.items()}
    if len({*counts.values()}) > 1:
        listed = ", ".join(f"{model} {count}" for model, count in counts.items())
        yield f"The models have unequal numbers of runs: {listed}."
    if single := [model for model, count in counts.items() if count == 1 and len(board.entries) > 1]:
        yield f"Only one run of {', '.join(single)}: without a spread, nothing can be decided about it."
    for model, entries in board.groups.items():
        twice = [seed for seed, n in Counter(e.seed for e in entries).items() if n > 1 and seed is not None]
        if twice:
            yield f"{model}: seed {twice[0]} occurs more than once, and is counted each time."


def _filters(board: Board) -> Iterator[str]:
    entries = board.entries
    kept = sum((entry.folder / PREDICTIONS).is_file() for entry in entries)
    if kept < len(entries):
        without = f"{len(entries) - kept} of {len(entries)} runs kept no predictions"
        yield f"{without}, so figures over time omit them."
    rows = [any(r.who.estimator and r.who.process == MODEL for r in e.results.rows) for e in entries]
    if not any(rows):
        later = any((entry.folder / "evaluations").is_dir() for entry in entries)
        rest = " Evaluations after the training (evaluations/) are not part of the report." if later else ""
        yield f"No training was evaluated with a filter (plugins=ukf, for simulated systems).{rest}"
    elif not all(rows):
        yield f"{rows.count(False)} of {len(rows)} runs were not evaluated with a filter."


def _unequal(board: Board) -> Iterator[str]:
    for model, entries in board.groups.items():
        for name, said in (("assumptions", [e.results.assumes for e in entries]), *_trainings(entries)):
            different = list(dict.fromkeys(said))
            if len(different) > 1:
                yield f"Runs of {model} differ in {name}: {', '.join(map(str, different[:5]))}."
    steps = {model: _value(entries[0], "steps") for model, entries in board.groups.items()}
    if len({*steps.values()}) > 1:
        listed = ", ".join(f"{model} {count}" for model, count in steps.items())
        yield f"The models were trained for unequal numbers of optimiser steps: {listed}."


def _trainings(entries: list[Entry]) -> Iterator[tuple[str, list[Any]]]:
    for key, name in (("steps", "optimiser steps"), ("parameters", "parameters"), ("window", "window")):
        yield name, [_value(entry, key) for entry in entries]


def _value(entry: Entry, key: str) -> str:
    return str(entry.results.training.get(key, "not known"))[:40]


def _floors(board: Board) -> Iterator[str]:
    found: dict[Any, list[float]] = {}
    for entry in board.entries:
        for row in entry.results.rows:
            if row.who.floor and row.who.estimator is None and math.isfinite(row.scores.position):
                found.setdefault(row.who, []).append(row.scores.position)
    if any(max(values) - min(values) > SAME * max(values) for values in found.values()):
        yield "The floors of the runs differ: they were not judged on the same trajectories."


def _lost(board: Board) -> Iterator[str]:
    for model, entries in board.groups.items():
        rows = [r for e in entries for r in e.results.rows if r.who.process == MODEL]
        lost = [row for row in rows if not math.isfinite(row.scores.position) and row.who.start != "fitted"]
        if lost:
            yield f"{model}: {len(lost)} of {len(rows)} scores are not finite: a prediction diverged."
