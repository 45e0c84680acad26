"""Scalars for TensorBoard, written every few steps: logging at each step would cost as much as a step."""

from __future__ import annotations

import math
import time
from typing import Any

from lightning import Callback, LightningModule, Trainer
from torch.nn.utils import get_total_norm
from torch.optim import Optimizer

from ahnn.arguments import Count, checked
from ahnn.errors import TrainingError

OF_STEP = ("lr", "damping", "gradient_norm")
"""Keys of optimiser parameter groups that are recorded where available."""

RECORDS = 100
"""Minimum number of records of a run, so that short runs have curves too."""

PATIENCE = 0.5
"""Seconds for which records are buffered: training waits whenever the logger's thread wakes up."""


@checked
class Telemetry(Callback):
    """Writes loss, learning rate and gradient norm, and stops the run on a non-finite gradient.

    Args:
        every: maximum number of optimiser steps between records.
    """

    def __init__(self, every: Count) -> None:
        self.most = self.every = every
        self._waiting: list[tuple[int, dict[str, float]]] = []
        self._due = 0.0

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Increase the recording frequency for short training runs."""
        total = int(trainer.num_training_batches) * int(trainer.max_epochs or 1)
        self.every = max(1, min(self.most, total // RECORDS))

    def on_before_optimizer_step(
        self, trainer: Trainer, pl_module: LightningModule, optimizer: Optimizer
    ) -> None:
        """Measure the gradient norm on recorded steps.

        Raises:
            TrainingError: the norm is not finite.
        """
        if trainer.global_step % self.every:
            return
        gradients = [p.grad for p in pl_module.parameters() if p.grad is not None]
        if not gradients:
            return
        norm = float(get_total_norm(gradients))
        if not math.isfinite(norm):
            message = (
                f"training: the gradient norm became {norm} in epoch {trainer.current_epoch}; "
                "the last good checkpoint is kept. Try a smaller optimizer.lr or window."
            )
            raise TrainingError(message)
        optimizer.param_groups[0]["gradient_norm"] = norm

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Record the training loss and the optimiser's step metrics."""
        if trainer.global_step % self.every == 0:
            group = trainer.optimizers[0].param_groups[0]
            of_step = {f"train/{name}": float(group[name]) for name in OF_STEP if name in group}
            self._waiting.append((trainer.global_step, {"train/loss": float(outputs["loss"]), **of_step}))
            if time.monotonic() >= self._due:
                self._write(trainer)

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Record the validation metrics, which are complete after the callbacks of the epoch's end."""
        metrics = {key: float(value) for key, value in trainer.callback_metrics.items() if "val/" in key}
        self._waiting.append((trainer.global_step, metrics))
        self._write(trainer)

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write buffered records."""
        self._write(trainer)

    def on_exception(self, trainer: Trainer, pl_module: LightningModule, exception: BaseException) -> None:
        """Write buffered records before the training ends."""
        self._write(trainer)

    def _write(self, trainer: Trainer) -> None:
        for step, metrics in self._waiting:
            for logger in trainer.loggers:
                logger.log_metrics(metrics, step=step)
        self._waiting.clear()
        self._due = time.monotonic() + PATIENCE
