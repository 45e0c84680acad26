"""How long a training takes on this machine, measured on a few of its own steps before it begins."""

from __future__ import annotations

import copy
import time
from collections.abc import Callable
from typing import Any

import torch

from ahnn.data.datamodule import WindowDataModule
from ahnn.training.objectives import Objective
from ahnn.training.steppers import stepper_of


def expected_seconds(
    trainer: Any, data: WindowDataModule, model: Any, per_epoch: int, epochs: range
) -> float:
    """Return about how long the rest of a training takes: steps, validations and callbacks.

    Args:
        trainer: with all its callbacks; those with a method `seconds` say themselves what an epoch costs.
        data: of the training.
        model: calibrated; it stays as it is.
        per_epoch: optimiser steps of an epoch.
        epochs: that are left, counted from 0.
    """
    timed = [callback for callback in trainer.callbacks if hasattr(callback, "seconds")]
    validation, of_step, total = _validation_seconds(model, data), dict[Objective, float](), 0.0
    for epoch in epochs:
        objective = model.curriculum.at(epoch, epochs.stop)
        if objective not in of_step:
            of_step[objective] = _step_seconds(model, data, objective)
        beside = sum(callback.seconds(epoch, trainer, model, data) for callback in timed)
        total += per_epoch * of_step[objective] + validation + beside
    return total


def _validation_seconds(model: Any, data: WindowDataModule) -> float:
    """Return the time of a validation, from that of its first batch."""
    batches = data.val_dataloader()
    first = next(iter(batches))
    with torch.no_grad():
        return len(batches) * _median(lambda: model.recursive.residuals(model.dynamics, first))


def _step_seconds(model: Any, data: WindowDataModule, objective: Objective) -> float:
    """Return the median time of an optimiser step on fresh batches, taken by a copy of the dynamics."""
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

    return _median(step, repeats=3)


def _median(work: Callable[[], Any], repeats: int = 1) -> float:
    """Return the median time of some work, a first call apart."""
    times = []
    for _ in range(repeats + 1):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return sorted(times[1:])[repeats // 2]
