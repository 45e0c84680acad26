"""Runtime estimate of a training run, measured on a few of its steps in advance."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable
from typing import Any

import torch

from ahnn.data.datamodule import WindowDataModule
from ahnn.training.closing_estimate import ShootingCost, closing_seconds, work
from ahnn.training.objectives import Objective
from ahnn.training.timers import median_seconds, seconds_of

TRIALS = 3
"""Maximum number of timed steps."""
LONG, FRACTIONS = 0.5, (1 / 8, 1 / 4)
"""Seconds of a step on the first of these fractions of a batch above which whole batches are not timed."""
REFITTED = 0.5
"""Relative cost of a step that starts from previously fitted initial states."""


def expected_seconds(
    trainer: Any,
    data: WindowDataModule,
    model: Any,
    per_epoch: int,
    epochs: range,
    shooting: ShootingCost | None = None,
) -> float:
    """Estimate the remaining time of a run in seconds: steps, validations and callbacks.

    Args:
        trainer: trainer with all callbacks; a callback's method `seconds` returns its cost per epoch.
        data: training data.
        model: calibrated model, which is not modified.
        per_epoch: optimiser steps per epoch.
        epochs: remaining epochs, counted from 0.
        shooting: measured cost of shooting, for a training on measurements; None without one.
    """
    timed = [callback for callback in trainer.callbacks if hasattr(callback, "seconds")]
    total = sum(c.seconds(epoch, trainer, model, data) for epoch in epochs for c in timed)
    if shooting is not None:
        return total + _on_measurements(model, data, per_epoch, epochs, shooting)
    validation, of_step = _validation_seconds(model, data), dict[Objective, float]()
    for epoch in epochs:
        objective = model.curriculum.at(epoch, epochs.stop)
        if objective not in of_step:
            of_step[objective] = step_seconds(model, data, objective)
        total += per_epoch * of_step[objective] + validation
    return total


def _on_measurements(
    model: Any, data: WindowDataModule, per_epoch: int, epochs: range, shooting: ShootingCost
) -> float:
    """Return the time of steps, validations and the closing stage, in proportion to their work.

    The first stage is timed, since over long segments paths of untrained dynamics are abandoned early.
    """
    objective = model.curriculum.at(0, epochs.stop)
    each = step_seconds(model, data, objective) / work(next(iter(data.train_dataloader())).times)
    times, steps = data.measured("train").times, model.curriculum.closing
    last = closing_seconds(shooting, times, objective.robust, steps)
    return last + each * sum(amounts(data, per_epoch, epochs))


def amounts(data: WindowDataModule, per_epoch: int, epochs: range) -> list[float]:
    """Return the work per epoch, including validation; 1 without stages."""
    if getattr(data, "stages", None) is None:
        return [1.0] * len(epochs)
    loader, found = data.train_dataloader(), []
    validation = REFITTED * work(next(iter(data.val_dataloader())).times)
    for epoch in epochs:
        loader.set_epoch(epoch)
        found.append(validation + per_epoch * work(next(iter(loader)).times))
    return found


def _validation_seconds(model: Any, data: WindowDataModule) -> float:
    """Return the time of a validation, from its first batch."""
    loader = data.val_dataloader()
    draw = loader.batches()[0]

    @torch.no_grad()
    def validation(fraction: float) -> None:
        model.curriculum.judge.validation(model.dynamics, loader.gather(_part(draw, fraction)))

    return len(loader) * _of_whole(validation)


def step_seconds(model: Any, data: WindowDataModule, objective: Objective) -> float:
    """Return the median time of an optimiser step on fresh batches, with a copy of the dynamics."""
    dynamics = copy.deepcopy(model.dynamics)
    optimizer = model.optimisation.optimizer(dynamics.parameters())
    stepper = model.stepper_for(optimizer)
    loader = data.train_dataloader()
    draws = itertools.cycle(loader.batches()[: TRIALS + 1])

    def step(fraction: float) -> None:
        batch = loader.gather(_part(next(draws), fraction))
        loss = stepper.step(objective, model.loss, dynamics, batch, optimizer)
        if stepper.automatic:
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()

    # If few segments are used, no equations may remain once the initial states are eliminated.
    if data.stages is not None:
        return median_seconds(lambda: step(1.0), TRIALS)
    return _of_whole(step, TRIALS)


def _part(draw: torch.Tensor, fraction: float) -> torch.Tensor:
    """Return the first indices of a batch."""
    return draw[: math.ceil(len(draw) * fraction)]


def _of_whole(work: Callable[[float], Any], repeats: int = 1) -> float:
    """Return the duration of work on a whole batch; if it is long, extrapolate it from two fractions."""
    small, large = FRACTIONS
    first = median_seconds(lambda: work(small))
    if first < LONG:
        return median_seconds(lambda: work(1.0), repeats)
    second = seconds_of(lambda: work(large))
    return second + (1 - large) / (large - small) * max(second - first, 0.0)
