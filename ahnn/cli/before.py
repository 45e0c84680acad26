"""Before the fit: a quiet Lightning, the folder of the run, and what cannot work."""

from __future__ import annotations

import logging
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from ahnn.errors import UserError
from ahnn.integrators import GaussLegendre4

if TYPE_CHECKING:
    from lightning import Trainer

    from ahnn.data.datamodule import WindowDataModule
    from ahnn.models import AbstractModel

HINTS = (
    ".*smaller than the logging interval.*",
    ".*does not have many workers.*",
    ".*Checkpoint directory.*exists.*",
    ".*ModelCheckpoint with manual optimization.*",
    ".*isinstance.treespec, LeafSpec.*",
    ".*did not find any unused parameters.*",
)
"""What Lightning warns of though it is intended, such as short epochs or a folder that is used again."""


def quiet() -> None:
    """Silence Lightning's warnings about what is intended."""
    from lightning.pytorch.utilities import rank_zero_only

    for name in ("lightning.pytorch", "lightning.fabric"):
        logging.getLogger(name).setLevel(logging.WARNING)
    if getattr(rank_zero_only, "rank", 0):  # of several processes, one speaks
        logging.getLogger("ahnn").setLevel(logging.WARNING)
    for hint in HINTS:
        warnings.filterwarnings("ignore", hint)


def require_new(folder: Path, ckpt: str | None) -> None:
    """Check that a training from the start replaces no other.

    Raises:
        UserError: the folder holds checkpoints.
    """
    found = sorted(path.name for path in (folder / "checkpoints").glob("*.ckpt"))
    if found and ckpt is None:
        message = (
            f"run {folder}: expected a folder without checkpoints; received one with {', '.join(found)}. "
            "Resume with ckpt=last, or choose another run="
        )
        raise UserError(message)


def check_training(
    trainer: Trainer, window: int, data: WindowDataModule, model: AbstractModel, *, multirun: bool
) -> None:
    """Check what no single part can see: W in three places, the optimiser's first step, the devices.

    Raises:
        UserError: parts that do not go together.
    """
    _check_spans(window, data, model)
    _check_optimisation(model)
    _check_steps(trainer, model)
    _check_devices(trainer, model, multirun=multirun)
    for callback in trainer.callbacks:  # pyright: ignore[reportAttributeAccessIssue]
        if check := getattr(callback, "check", None):
            check(trainer)


def _check_spans(window: int, data: WindowDataModule, model: AbstractModel) -> None:
    received = {"window": window, "data.window": data.window, "model.window": model.window}
    if len({*received.values()}) > 1:
        odd = next(value for value in received.values() if value != window)
        message = (
            "window: expected one W for data, model and label; received "
            f"{', '.join(f'{name}={value}' for name, value in received.items())}. Set window={odd} alone"
        )
        raise UserError(message)
    truth: Any = data.source.truth
    if truth is None or getattr(truth, "periods", None) is not None:
        return
    if not 1 <= data.window <= truth.steps:
        message = (
            f"window: expected 1 <= W <= {truth.steps}, the steps of a {truth.name} trajectory; "
            f"received W={data.window}"
        )
        raise UserError(message)
    if data.stencil > max(truth.steps, data.window):
        message = (
            f"loss: derivatives of order {data.stencil} expect at least {data.stencil} steps a trajectory; "
            f"received {truth.steps}. Set loss.order={max(2, truth.steps // 2 * 2)} or loss.derivative=0"
        )
        raise UserError(message)


def _check_optimisation(model: AbstractModel) -> None:
    """Build optimiser and scheduler for a trial, which also shows how steps are taken."""
    configured = model.configure_optimizers()
    if not isinstance(configured, dict):
        return
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that the optimiser took no step before
            configured["lr_scheduler"]["scheduler"].step()
    except (ArithmeticError, TypeError, ValueError) as error:
        message = f"scheduler: it cannot take a step with these settings: {error}"
        raise UserError(message) from error


def _check_steps(trainer: Trainer, model: AbstractModel) -> None:
    """Refuse what only gradients can do where an optimiser takes its own steps."""
    if trainer.fast_dev_run:  # pyright: ignore[reportAttributeAccessIssue]
        message = "trainer.fast_dev_run: expected false, since it keeps no weights to judge; use budget=smoke"
        raise UserError(message)
    if model.automatic_optimization:
        return
    if next(model.dynamics.parameters()).dtype != torch.float64:
        message = (
            "data.precision: expected 64 with levenberg_marquardt, whose steps need the digits; received 32. "
            "Set data.precision=64, or choose recipe=first_order"
        )
        raise UserError(message)
    method = getattr(model.dynamics, "integrator", None)
    if isinstance(method, GaussLegendre4):
        message = (
            "integrator gl4: expected an explicit method with levenberg_marquardt, which differentiates "
            "through no iteration. Choose integrator=rk4, or recipe=first_order"
        )
        raise UserError(message)
    for name, neutral in (("gradient_clip_val", 0), ("accumulate_grad_batches", 1)):
        if (value := getattr(trainer, name)) not in (neutral, None):
            message = (
                f"trainer.{name}: expected none with levenberg_marquardt, which takes its own steps; "
                f"received {value}. Leave it out, or choose recipe=first_order"
            )
            raise UserError(message)


def _check_devices(trainer: Trainer, model: AbstractModel, *, multirun: bool) -> None:
    """Refuse second-order steps on several devices, and several devices inside the process of a sweep."""
    from lightning.pytorch.strategies import DDPStrategy

    if isinstance(trainer.strategy, DDPStrategy) and not trainer.strategy._ddp_kwargs:
        message = (
            "trainer.strategy: expected one that allows unused parameters; received ddp. Use trainer=ddp"
        )
        raise UserError(message)
    if trainer.world_size == 1:
        return
    received = f"received {trainer.world_size} devices"
    if not model.automatic_optimization:
        message = (
            "trainer: expected one device for levenberg_marquardt, which takes its steps on one; "
            f"{received}. Choose recipe=first_order, or trainer=default"
        )
        raise UserError(message)
    environment = getattr(trainer.strategy, "cluster_environment", None)
    if multirun and not (environment and environment.creates_processes_externally):
        message = (
            f"trainer: expected one device, or a process for each job of the sweep; {received} inside the "
            "process of the sweep. Add hydra/launcher=ahnn_process"
        )
        raise UserError(message)
