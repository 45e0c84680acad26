"""Evaluation after fit: rollouts of unseen trajectories, floors, scores, table, figures, plugins."""

from __future__ import annotations

from ahnn.evaluation.case import Case, EvaluationPlugin, Findings, Row
from ahnn.evaluation.run import evaluate, make_case, write_findings

__all__ = ["Case", "EvaluationPlugin", "Findings", "Row", "evaluate", "make_case", "write_findings"]
