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
    """Let a calibrated model compile its optimiser steps, or not.

    Compiled steps round differently: a resumed training takes those that it began with.
    """
    from ahnn.checkpoints import read_checkpoint
    from ahnn.training.payback import choose

    asked = cfg.compile
    if asked == "auto" and checkpoint is not None:
        asked = read_checkpoint(checkpoint)["ahnn"].get("compiled") is True
    choose(asked, trainer, data, model, Path(cfg.data.cache))
