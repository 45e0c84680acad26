"""Evaluation of a trained model: rollouts of unseen trajectories, floors, rows, results.

A `Case` is the input of an evaluation. `report` writes the findings; `evaluate` only returns them. Every
row has an identity, `Who`, and every output has the same `Results`, which `load_results` reads back.
"""

from __future__ import annotations

from ahnn.evaluation.case import Case, EvaluationPlugin, Findings, Row, Who
from ahnn.evaluation.folders import evaluation_folder
from ahnn.evaluation.publish import report
from ahnn.evaluation.results import Results, load_results
from ahnn.evaluation.run import evaluate

__all__ = [
    "Case",
    "EvaluationPlugin",
    "Findings",
    "Results",
    "Row",
    "Who",
    "evaluate",
    "evaluation_folder",
    "load_results",
    "report",
]
