"""The end of a run: a case is evaluated, and its results go to every sink."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ahnn.evaluation.case import Case, EvaluationPlugin, Findings
from ahnn.evaluation.provenance import provenance
from ahnn.evaluation.results import Results
from ahnn.evaluation.run import evaluate
from ahnn.evaluation.sinks import FigureSink, MetricsSink, PredictionSink, Sink, TableSink

log = logging.getLogger(__name__)


def report(
    case: Case,
    plugins: Mapping[str, EvaluationPlugin],
    training: Mapping[str, Any],
    *,
    more: Iterable[Sink] = (),
    predictions: bool = True,
    figures: bool = True,
    detail: bool = False,
) -> Results:
    """Evaluate a case, write the files into its folder, print the table, and return the results.

    Args:
        case: what to evaluate, and the folder for the results.
        plugins: evaluations to run after the open-loop one, by name.
        training: numbers on the training: `seed`, `window`, `val_loss`, `seconds`, `steps`, `parameters`, ...
        more: sinks beside table and files, such as a `TensorBoardSink`.
        predictions: whether to keep the predicted trajectories.
        figures: whether to draw; the trials of a search are told apart by numbers.
        detail: whether the table ends with pooled errors and those of each component.
    """
    findings = evaluate(case, plugins, figures=figures)
    results = make_results(case, findings, training, provenance())
    files = file_sinks(case.folder, predictions=predictions)
    for sink in (*files, *more, TableSink(detail)):  # a terminal that has gone takes no file along
        sink(results, findings)
    log.info("results: %s", case.folder)
    return results


def make_results(
    case: Case, findings: Findings, training: Mapping[str, Any], about: Mapping[str, Any]
) -> Results:
    """Return the results of an evaluation."""
    return Results(
        label=case.label,
        assumes=case.assumes,
        space=case.space,
        rows=tuple(findings.rows),
        training=dict(training),
        numbers=findings.numbers,
        about=dict(about),
    )


def file_sinks(folder: Path, *, predictions: bool = True) -> tuple[Sink, ...]:
    """Return the sinks that write into a folder; what an earlier evaluation left there is replaced."""
    return MetricsSink(folder), PredictionSink(folder, predictions), FigureSink(folder)
