"""Evaluation of a case at the end of a run, with output to files, TensorBoard and the terminal."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from safetensors.torch import save
from torch import Tensor

from ahnn.evaluation.case import Case, EvaluationPlugin, Findings
from ahnn.evaluation.provenance import provenance
from ahnn.evaluation.results import Results, write_results
from ahnn.evaluation.run import evaluate
from ahnn.evaluation.score_table import results_table
from ahnn.evaluation.sinks.figure_files import write_figures
from ahnn.evaluation.sinks.tensorboard import log_scores
from ahnn.evaluation.terminal import show
from ahnn.files import write_atomically
from ahnn.manifest import remove_own

log = logging.getLogger(__name__)


def report(
    case: Case,
    plugins: Mapping[str, EvaluationPlugin],
    training: Mapping[str, Any],
    *,
    boards: Iterable[tuple[Any, Mapping[str, Any]]] = (),
    predictions: bool = True,
    figures: bool = True,
    detail: bool = False,
) -> Results:
    """Evaluate a case, write files to its folder, print the table, and return the results.

    Args:
        case: case to evaluate, with the output folder; output of an earlier evaluation is replaced.
        plugins: additional evaluations by name.
        training: training information: `seed`, `window`, `val_loss`, `seconds`, `steps`, `parameters`, ...
        boards: TensorBoard loggers, each with its hyper-parameters; see `log_scores`.
        predictions: whether to keep the predicted trajectories.
        figures: whether to draw figures, which trials of a search do not need.
        detail: whether the table includes pooled and component errors.
    """
    findings = evaluate(case, plugins, figures=figures)
    results = make_results(case, findings, training, provenance())
    write_results(case.folder, results)
    write_predictions(case.folder, results, findings.arrays, keep=predictions)
    write_figures(case.folder, findings.figures)
    for logger, settings in boards:
        log_scores(logger, settings, results, findings.figures)
    show(results_table(results, detail=detail))  # last: a closed terminal must not prevent file output
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


def write_predictions(folder: Path, results: Results, arrays: Mapping[str, Tensor], *, keep: bool) -> None:
    """Write predictions.safetensors, or remove that of an earlier evaluation.

    Args:
        folder: folder of the evaluation.
        results: results, with the names of system and model.
        arrays: truth, times, predictions and the arrays of plugins, float64.
        keep: whether to write the arrays.
    """
    path = folder / "predictions.safetensors"
    if not keep:
        remove_own(path)
        return
    content = {key: value.contiguous() for key, value in arrays.items()}
    write_atomically(path, save(content, {"system": results.space.name, "model": results.label}))
