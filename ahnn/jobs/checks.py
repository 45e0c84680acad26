"""Whether data, model and trainer fit each other, asked before anything is generated."""

from __future__ import annotations

from typing import Any

from lightning import Trainer

from ahnn.data.datamodule import WindowDataModule
from ahnn.memory import require_memory
from ahnn.models import AbstractModel
from ahnn.training.identifiability import require_identifiable, require_unbiased
from ahnn.training.normal_equations import memory_of, memory_of_parts
from ahnn.training.objectives import PARTS


def check_learnable(model: AbstractModel, data: WindowDataModule, balance: float) -> None:
    """Refuse dynamics that the data cannot determine, or that the floor cannot be integrated with.

    Args:
        model: with its objectives.
        data: with what training sees of them.
        balance: of the loss, 1 weighs residuals by the local increment.

    Raises:
        UserError: names the key.
    """
    if (method := getattr(model.dynamics, "integrator", None)) and data.source.truth is not None:
        method.require(data.source.truth)  # the floor goes through the integrator of the model
    if data.sensor is not None:
        require_identifiable(model.dynamics, data.sensor, windows=model.curriculum.span is not None)
        require_unbiased(balance)


def check_together(trainer: Trainer, model: AbstractModel, data: WindowDataModule) -> None:
    """Let model and callbacks refuse, by a method `check`, what they cannot work with; raises UserError."""
    parts: list[Any] = [model, *trainer.callbacks]  # pyright: ignore[reportAttributeAccessIssue]
    for part in parts:
        if check := getattr(part, "check", None):
            check(trainer)
    if not model.stepper.automatic:
        require_equations(model, data)


def require_equations(model: AbstractModel, data: WindowDataModule) -> None:
    """Refuse second-order steps whose equations do not fit into memory; raises UserError."""
    count = sum(p.numel() for p in model.dynamics.parameters())
    if data.stages is None:
        windows = min(data.batch_size, data.windows_per_epoch or data.batch_size)
        size = memory_of(count, 2 * model.dof * max(1, windows // PARTS))
    else:
        size = memory_of_parts(count)
    who = "model.network" if size < 2 * memory_of(count, 0) or data.stages else "data.batch_size"
    remedy = "Choose a smaller network or batch" + ("" if data.stages else ", or recipe=first_order")
    require_memory(who, f"the equations of second-order steps on {count:,} parameters", size, remedy)
