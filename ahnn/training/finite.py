"""Checks that loss and weights stay finite during training."""

from __future__ import annotations

import math

from torch import nn

from ahnn.errors import TrainingError

REMEDY = "the last good checkpoint is kept. Try a smaller optimizer.lr or window"


def require_finite_loss(loss: float, where: str) -> None:
    """Raise TrainingError for a loss that is not finite."""
    if not math.isfinite(loss):
        message = f"training diverged: the loss became {loss} {where}; {REMEDY}"
        raise TrainingError(message)


def require_finite_weights(module: nn.Module, where: str) -> None:
    """Raise TrainingError for a weight that is not finite; the loss of a step precedes its update."""
    if not all(bool(p.isfinite().all()) for p in module.parameters()):
        message = f"training diverged: weights became nan or inf {where}; {REMEDY}"
        raise TrainingError(message)
