"""Output of the results table to standard output."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from ahnn.evaluation.case import Findings
from ahnn.evaluation.results import Results
from ahnn.evaluation.score_table import results_table
from ahnn.evaluation.terminal import show


@final
@dataclass(frozen=True)
class TableSink:
    """Prints the results table.

    Attributes:
        detail: whether to include pooled and component errors.
    """

    detail: bool = False

    def __call__(self, results: Results, findings: Findings) -> None:  # noqa: ARG002
        """Print the table of the results."""
        show(results_table(results, detail=self.detail))
