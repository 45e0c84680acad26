"""Evaluation of a case at the end of a run, with output to all sinks."""

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
    """Evaluate a case, write files to its folder, print the table, and return the results.

    Args:
        case: case to evaluate, with the output folder.
        plugins: additional evaluations by name.
        training: training information: `seed`, `window`, `val_loss`, `seconds`, `steps`, `parameters`, ...
        more: additional sinks, such as a `TensorBoardSink`.
        predictions: whether to keep the predicted trajectories.
        figures: whether to draw figures, which trials of a search do not need.
        detail: whether the table includes pooled and component errors.
    """
    findings = evaluate(case, plugins, figures=figures)
    results = make_results(case, findings, training, provenance())
    files = file_sinks(case.folder, predictions=predictions)
    for sink in (*files, *more, TableSink(detail)):  # a closed terminal must not prevent file output
        sink(results, findings)
    log.info("results: %s", case.folder)
    return results


def make_results(
    case: Case, findings: Findings, training: Mapping[str, Any], about: Mapping[str, Any]
) -> Results:
    """Build the results of an evaluation."""
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
    """Return the sinks that write into a folder, replacing output of earlier evaluations."""
    return MetricsSink(folder), PredictionSink(folder, predictions), FigureSink(folder)
