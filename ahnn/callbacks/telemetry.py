"""Scalars for TensorBoard, written every few steps: a log call on each step would cost as much as a step."""

from __future__ import annotations

from typing import Any

import torch
from lightning import Callback, LightningModule, Trainer
from torch.nn.utils import get_total_norm
from torch.optim import Optimizer

from ahnn.errors import TrainingError, UserError


class Telemetry(Callback):
    """Writes loss, learning rate and gradient norm, and stops the run when a gradient is not finite.

    Args:
        every: optimiser steps between two records.
    """

    def __init__(self, every: int) -> None:
        if every < 1:
            message = f"callbacks.telemetry: every: expected at least 1 step; received {every}"
            raise UserError(message)
        self.every = every

    def on_before_optimizer_step(
        self, trainer: Trainer, pl_module: LightningModule, optimizer: Optimizer
    ) -> None:
        """Measure the gradient norm on the steps that are recorded.

        Raises:
            TrainingError: the norm is not finite.
        """
        if trainer.global_step % self.every:
            return
        gradients = [p.grad for p in pl_module.parameters() if p.grad is not None]
        norm = get_total_norm(gradients) if gradients else torch.zeros(())
        if not norm.isfinite():
            message = (
                f"training: the gradient norm became {float(norm)} in epoch {trainer.current_epoch}; "
                "the last good checkpoint is kept. Try a smaller optimizer.lr or window."
            )
            raise TrainingError(message)
        group = optimizer.param_groups[0]
        metrics = {f"train/{name}": float(group[name]) for name in ("lr", "damping") if name in group}
        self._write(trainer, {"train/gradient_norm": float(norm), **metrics})

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Record the training loss."""
        del pl_module, batch, batch_idx
        if trainer.global_step % self.every == 0:
            self._write(trainer, {"train/loss": float(outputs["loss"])})

    def on_validation_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Record the validation metrics."""
        del pl_module
        metrics = {key: float(value) for key, value in trainer.callback_metrics.items() if "val/" in key}
        self._write(trainer, metrics)

    @staticmethod
    def _write(trainer: Trainer, metrics: dict[str, float]) -> None:
        for logger in trainer.loggers:
            logger.log_metrics(metrics, step=trainer.global_step)
