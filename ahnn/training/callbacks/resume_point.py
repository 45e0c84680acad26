"""The checkpoint to go on from after an interruption: last.ckpt, within an epoch and at its end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import Checkpoint

from ahnn.arguments import Count, checked
from ahnn.models import AbstractDynamics


@checked
class ResumePoint(Checkpoint):
    """Writes last.ckpt atomically every few steps and after each validation.

    Never between the last step of an epoch and its validation: Lightning would skip that validation when it
    goes on from there, and the best checkpoint would differ from that of an uninterrupted run.

    Args:
        folder: where last.ckpt is written.
        every: optimiser steps between two writes within an epoch.
    """

    def __init__(self, folder: str, every: Count) -> None:
        self.path = Path(folder) / "last.ckpt"
        self.every = every

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Write when due, but not on the last batch of an epoch."""
        del outputs, batch, batch_idx
        if trainer.global_step % self.every == 0 and not trainer.is_last_batch:
            assert isinstance(pl_module, AbstractDynamics)
            pl_module.require_finite()
            trainer.save_checkpoint(self.path)

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write at the end of an epoch."""
        del pl_module
        if trainer.state.fn == "fit" and not trainer.sanity_checking:
            trainer.save_checkpoint(self.path)
