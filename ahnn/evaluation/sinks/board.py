"""TensorBoard events of an evaluation outside training."""

from __future__ import annotations

from pathlib import Path
from typing import Any


class EventBoard:
    """Logger for `log_scores`, based on torch's own writer.

    Args:
        folder: folder of the events.
    """

    def __init__(self, folder: Path) -> None:
        from torch.utils.tensorboard.writer import SummaryWriter

        self.experiment: Any = SummaryWriter(str(folder))

    def log_hyperparams(self, params: dict[str, Any], metrics: dict[str, Any]) -> None:
        """Write hyper-parameters with the resulting metrics, and each metric as a scalar."""
        from torch.utils.tensorboard.summary import hparams

        plain = {k: v if isinstance(v, int | float | str | bool) else str(v) for k, v in params.items()}
        for summary in hparams(plain, metrics):
            self.experiment.file_writer.add_summary(summary)
        for name, value in metrics.items():
            self.experiment.add_scalar(name, value, 0)

    def finalize(self, status: str) -> None:
        """Close the file."""
        self.experiment.close()
