"""Before the fit: a quiet Lightning, the checkpoint to go on from, and what the user is in for."""

from __future__ import annotations

import contextlib
import copy
import logging
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from lightning import Trainer
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.utilities import rank_zero_only

from ahnn.checkpoints import read_checkpoint, require_same
from ahnn.data import WindowDataModule
from ahnn.errors import UserError
from ahnn.models import AbstractDynamics
from ahnn.types import Window

log = logging.getLogger(__name__)


def quiet() -> None:
    """Silence Lightning's hints on what is intended, such as short epochs or a folder that is used again."""
    for name in ("lightning.pytorch", "lightning.fabric"):
        logging.getLogger(name).setLevel(logging.WARNING)
    if getattr(rank_zero_only, "rank", 0):  # of several processes, one speaks
        logging.getLogger("ahnn").setLevel(logging.WARNING)
    hints = (
        ".*smaller than the logging interval.*",
        ".*does not have many workers.*",
        ".*Checkpoint directory.*exists.*",
        ".*ModelCheckpoint with manual optimization.*",
        ".*isinstance.treespec, LeafSpec.*",
        ".*did not find any unused parameters.*",
    )
    for hint in hints:
        warnings.filterwarnings("ignore", hint)


def resume_point(ckpt: str | None, model: AbstractDynamics, folder: Path) -> Path | None:
    """Return the checkpoint to go on from, or None.

    Args:
        ckpt: None, `last`, `best`, or a path.
        model: what is going to be trained; the checkpoint must be of the same.
        folder: where checkpoints of this run are.

    Raises:
        UserError: the checkpoint is missing, damaged, or of another model or system.
    """
    if ckpt is None:
        return None
    path = folder / f"{ckpt}.ckpt" if ckpt in ("last", "best") else Path(ckpt)
    content = read_checkpoint(path)
    received = {"model": dict(content["hyper_parameters"]), "system": content["ahnn"].get("system", {})}
    require_same(f"checkpoint {path}", {"model": dict(model.hparams), **model.provenance}, received)
    return path


def require_new(folder: Path, ckpt: str | None) -> None:
    """Check that a training from the start replaces no other.

    Raises:
        UserError: the folder holds checkpoints.
    """
    found = sorted(path.name for path in (folder / "checkpoints").glob("*.ckpt"))
    if found and ckpt is None:
        message = (
            f"run {folder}: expected a folder without checkpoints; found {', '.join(found)}. "
            "Go on with ckpt=last, or choose another run="
        )
        raise UserError(message)


def check_spans(window: int, data: WindowDataModule, model: AbstractDynamics) -> None:
    """Check that there is one W, and that trajectories are long enough for the derivatives of the loss.

    Raises:
        UserError: W was set in one place and not in the others, or too few steps.
    """
    received = {"window": window, "data.window": data.window, "model.window": model.window}
    if len({*received.values()}) > 1:
        odd = next(value for value in received.values() if value != window)
        message = (
            "window: expected one W for data, model and label; received "
            f"{', '.join(f'{name}={value}' for name, value in received.items())}. Set window={odd} alone"
        )
        raise UserError(message)
    steps = data.system.steps
    if data.stencil > max(steps, data.window) and getattr(data.system, "periods", None) is None:
        message = (
            f"loss: derivatives of order {data.stencil} expect at least {data.stencil} steps a trajectory; "
            f"received {steps}. Set loss.order={max(2, steps // 2 * 2)} or loss.derivative=0"
        )
        raise UserError(message)


def check_optimisation(model: AbstractDynamics) -> None:
    """Build optimiser and scheduler for a trial, which also shows whether gradients are stepped on.

    Raises:
        UserError: the scheduler cannot take its first step.
    """
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


def check_steps(trainer: Trainer, model: AbstractDynamics) -> None:
    """Check that nothing is asked of second-order steps that only gradients can do.

    Raises:
        UserError: clipped or accumulated gradients.
    """
    if model.automatic_optimization:
        return
    for name, neutral in (("gradient_clip_val", 0), ("accumulate_grad_batches", 1)):
        if (value := getattr(trainer, name)) not in (neutral, None):
            message = (
                f"trainer.{name}: expected none with levenberg_marquardt, which takes its own steps; "
                f"received {value}. Leave it out, or choose recipe=first_order"
            )
            raise UserError(message)


@contextlib.contextmanager
def interruptible(trainer: Trainer, how_to_go_on: Callable[[], str]) -> Iterator[None]:
    """Turn what ends a fit early by the user's will or mistake into one message.

    Lightning answers Ctrl-C with an exit of its own, code 1.

    Raises:
        KeyboardInterrupt: with what to type to go on.
        UserError: settings of the trainer that do not go together.
    """
    try:
        yield
    except (KeyboardInterrupt, SystemExit) as stop:
        if not isinstance(stop, KeyboardInterrupt) and not isinstance(stop.__context__, KeyboardInterrupt):
            raise
        if not trainer.is_global_zero:
            sys.exit(130)  # of several processes, one speaks
        message = f"stopped by Ctrl-C; {how_to_go_on()}"
        raise KeyboardInterrupt(message) from None
    except MisconfigurationException as error:
        message = f"trainer: {error}"
        raise UserError(message) from error


def check_devices(trainer: Trainer, model: AbstractDynamics, *, multirun: bool) -> None:
    """Check that a training on several devices can do what is asked for.

    Raises:
        UserError: second-order steps on several devices, or a job inside the process of a sweep: the other
            processes would repeat the command of the whole sweep.
    """
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


def announce(trainer: Trainer, data: WindowDataModule, model: AbstractDynamics, label: str) -> None:
    """Say how many optimiser steps the training takes and about how long on this machine."""
    steps = len(data.train_dataloader()) * int(trainer.max_epochs or 1)
    seconds = steps * seconds_per_step(data, model)
    duration = f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"
    log.info(
        "training %s on %s: %s optimiser steps of %d windows in %d epochs, about %s on this machine",
        label,
        data.system.name,
        f"{steps:,}",
        data.batch_size,
        trainer.max_epochs,
        duration,
    )


def seconds_per_step(data: WindowDataModule, model: AbstractDynamics) -> float:
    """Return the mean time of an optimiser step over both phases of the loss, on a copy of the model."""
    share = model.loss.derivative
    windows = data.train_dataloader().windows
    batch = windows.gather(torch.arange(data.batch_size) % len(windows))
    phases = ((share, 1.0), (1 - share, 0.0))
    return sum(weight * _median_step(model, batch, derivative) for weight, derivative in phases if weight > 0)


def _median_step(model: AbstractDynamics, batch: Window, derivative: float, repeats: int = 5) -> float:
    """Return the median time of a step of one phase."""
    model = copy.deepcopy(model)
    model.loss = replace(model.loss, derivative=derivative)
    assert model.optimisation is not None
    optimizer = model.optimisation.optimizer(model.parameters())

    def gradient() -> torch.Tensor:
        optimizer.zero_grad()
        loss = model.loss(model.residuals(batch))
        loss.backward()
        return loss

    closure: Any = gradient if model.automatic_optimization else lambda: model.problems(batch)
    times = []
    for _ in range(repeats + 1):
        begin = time.perf_counter()
        optimizer.step(closure)
        times.append(time.perf_counter() - begin)
    return sorted(times[1:])[repeats // 2]
