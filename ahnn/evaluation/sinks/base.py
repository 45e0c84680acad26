"""What a sink is, and what it needs of a logger."""

from __future__ import annotations

from typing import Any, Protocol

from ahnn.evaluation.case import Findings
from ahnn.evaluation.results import Results


class Sink(Protocol):
    """A place for results; it knows folder or logger from its construction."""

    def __call__(self, results: Results, findings: Findings) -> None:
        """Write results, or the arrays or figures behind them."""
        ...


class TensorBoardLike(Protocol):
    """The part of Lightning's TensorBoard logger that is used."""

    @property
    def experiment(self) -> Any:
        """The SummaryWriter."""
        ...

    def log_hyperparams(self, params: dict[str, Any], metrics: dict[str, Any]) -> None:
        """Write hyper-parameters with the metrics that they led to."""
        ...

    def finalize(self, status: str) -> None:
        """Flush what was written."""
        ...
