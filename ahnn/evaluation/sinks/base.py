"""Protocols of sinks and of the logger that they use."""

from __future__ import annotations

from typing import Any, Protocol

from ahnn.evaluation.case import Findings
from ahnn.evaluation.results import Results


class Sink(Protocol):
    """Output of results; the folder or logger is set at construction."""

    def __call__(self, results: Results, findings: Findings) -> None:
        """Write results, or their arrays or figures."""
        ...


class TensorBoardLike(Protocol):
    """Methods of Lightning's TensorBoard logger that the sink calls."""

    @property
    def experiment(self) -> Any:
        """The SummaryWriter."""
        ...

    def log_hyperparams(self, params: dict[str, Any], metrics: dict[str, Any]) -> None:
        """Write hyper-parameters with the resulting metrics."""
        ...

    def finalize(self, status: str) -> None:
        """Flush the output."""
        ...
