"""What a user is in for: how many steps a training takes, and about how long on this machine."""

from __future__ import annotations

import copy
import logging
import time
from typing import TYPE_CHECKING, Any

import torch

from ahnn.training import Objective, stepper_of

if TYPE_CHECKING:
    from lightning import Trainer

    from ahnn.data.datamodule import WindowDataModule
    from ahnn.models import AbstractModel

log = logging.getLogger("ahnn")


def announce(trainer: Trainer, data: WindowDataModule, model: AbstractModel, label: str, done: int) -> None:
    """Say how many optimiser steps are left of a training, and about how long they take.

    Args:
        trainer: with all its callbacks.
        data: of the training.
        model: calibrated.
        label: name in tables.
        done: optimiser steps that a resumed training has already taken.
    """
    per_epoch = -(-len(data.train_dataloader()) // trainer.accumulate_grad_batches)
    epochs = range(done // per_epoch, int(trainer.max_epochs or 1))
    seconds = sum(seconds_left(trainer, data, model, per_epoch, epochs))
    duration = f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.1f} min"
    log.info(
        "training %s on %s: %s optimiser steps of %d windows in %d epochs, about %s on this machine",
        label,
        data.source.space.name,
        f"{per_epoch * epochs.stop - done:,}",
        data.batch_size,
        len(epochs),
        duration,
    )


def seconds_left(
    trainer: Trainer, data: WindowDataModule, model: AbstractModel, per_epoch: int, epochs: range
) -> list[float]:
    """Return the expected time of each epoch that is left: steps, validation, callbacks with their own."""
    model = copy.deepcopy(model)
    known: dict[int, float] = {}
    validation = _validation_seconds(model, data)
    times = []
    for epoch in epochs:
        objective = model.curriculum.at(epoch, epochs.stop)
        if id(objective) not in known:
            known[id(objective)] = _step_seconds(model, data, objective)
        beside = [c.seconds(epoch, trainer, model, data) for c in _timed(trainer)]
        times.append(per_epoch * known[id(objective)] + validation + sum(beside))
    return times


def _timed(trainer: Trainer) -> list[Any]:
    return [c for c in trainer.callbacks if hasattr(c, "seconds")]  # pyright: ignore[reportAttributeAccessIssue]


def _validation_seconds(model: AbstractModel, data: WindowDataModule) -> float:
    """Return the time of a validation, from that of its first batch."""
    batches = data.val_dataloader()
    first = next(iter(batches))
    with torch.no_grad():
        return len(batches) * _seconds(lambda: model.recursive.residuals(model.dynamics, first))


def _step_seconds(model: AbstractModel, data: WindowDataModule, objective: Objective) -> float:
    """Return the median time of an optimiser step on fresh batches."""
    assert model.optimisation is not None
    dynamics = copy.deepcopy(model.dynamics)
    optimizer = model.optimisation.optimizer(dynamics.parameters())
    stepper = stepper_of(optimizer)
    windows = data.train_dataloader().windows
    draw = torch.Generator().manual_seed(0)

    def step() -> None:
        index = torch.randint(len(windows), (min(data.batch_size, len(windows)),), generator=draw)
        loss = stepper.step(objective, model.loss, dynamics, windows.gather(index), optimizer)
        if stepper.automatic:
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()

    return _seconds(step, repeats=3)


def _seconds(work: Any, repeats: int = 1) -> float:
    """Return the median time of some work, a first call apart."""
    times = []
    for _ in range(repeats + 1):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return sorted(times[1:])[repeats // 2]
