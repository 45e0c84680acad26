"""Whether a training compiles its steps: as the command says, or as the training did that it resumes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from omegaconf import DictConfig

if TYPE_CHECKING:
    from lightning import Trainer

    from ahnn.data.datamodule import WindowDataModule
    from ahnn.models import AbstractModel


def choose_steps(
    cfg: DictConfig, trainer: Trainer, data: WindowDataModule, model: AbstractModel, checkpoint: Path | None
) -> None:
    """Let a calibrated model compile its optimiser steps, or not; a resumed training as it began."""
    from ahnn.checkpoints import read_checkpoint
    from ahnn.training.payback import choose

    before = None if checkpoint is None else read_checkpoint(checkpoint)["ahnn"].get("compiled") is True
    choose(cfg.compile, trainer, data, model, Path(cfg.data.cache), before)
