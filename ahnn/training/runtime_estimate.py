"""Runtime estimate of a training run, measured on a few of its steps in advance."""

from __future__ import annotations

import copy
import itertools
import math
import time
from collections.abc import Callable
from statistics import median
from typing import Any

import torch
from torch.nn.utils import parameters_to_vector

from ahnn.data.datamodule import WindowDataModule
from ahnn.data.segments import Segments
from ahnn.shooting.robust import ROBUST
from ahnn.training.maximum_posterior import WideProblem
from ahnn.training.objectives import Objective

TRIALS = 3
"""Maximum number of timed steps."""
ENOUGH = 0.25
"""Total duration of timed steps that suffices, in seconds: of longer steps only one is timed."""
LONG, FRACTIONS = 0.5, (1 / 8, 1 / 4)
"""Seconds of a step on the first of these fractions of a batch above which whole batches are not timed."""
REFITTED = 0.5
"""Relative cost of a step that starts from previously fitted initial states."""
CLOSING = 4.5
"""Measured cost of the closing stage without parameter steps, in units of one set of normal equations."""
ROWS = 100
"""Number of segments that together cost as much as the fixed part of a time step."""
SEGMENTS, INTERVALS = 300, 64
"""Maximum number of segments on which final steps are timed, and of their measurement intervals."""


def expected_seconds(
    trainer: Any, data: WindowDataModule, model: Any, per_epoch: int, epochs: range
) -> float:
    """Estimate the remaining time of a run in seconds: steps, validations and callbacks.

    Args:
        trainer: trainer with all callbacks; a callback's method `seconds` returns its cost per epoch.
        data: training data.
        model: calibrated model, which is not modified.
        per_epoch: optimiser steps per epoch.
        epochs: remaining epochs, counted from 0.
    """
    timed = [callback for callback in trainer.callbacks if hasattr(callback, "seconds")]
    total = sum(c.seconds(epoch, trainer, model, data) for epoch in epochs for c in timed)
    if data.stages is not None:
        return total + _on_measurements(model, data, per_epoch, epochs)
    validation, of_step = _validation_seconds(model, data), dict[Objective, float]()
    for epoch in epochs:
        objective = model.curriculum.at(epoch, epochs.stop)
        if objective not in of_step:
            of_step[objective] = step_seconds(model, data, objective)
        total += per_epoch * of_step[objective] + validation
    return total


def _on_measurements(model: Any, data: WindowDataModule, per_epoch: int, epochs: range) -> float:
    """Return the time of steps, validations and the closing stage, in proportion to their work.

    The first stage is timed, since over long segments paths of untrained dynamics are abandoned early.
    """
    objective = model.curriculum.at(0, epochs.stop)
    each = step_seconds(model, data, objective) / work(next(iter(data.train_dataloader())).times)
    last = shooting_seconds(model, data) * (CLOSING + REFITTED * model.curriculum.closing)
    return last * work(data.measured("train").times) + each * sum(amounts(data, per_epoch, epochs))


def work(times: torch.Tensor) -> float:
    """Return the work of a batch of segments with these times (B, T), in steps of one segment."""
    rows, samples = times.shape
    return float(samples * (rows + ROWS))


def shooting_seconds(model: Any, data: WindowDataModule) -> float:
    """Return the duration of shooting fits and normal equations per unit of `work`.

    It is timed on the first intervals of trajectories, since untrained dynamics soon diverge.
    """
    dynamics = copy.deepcopy(model.dynamics).double().cpu()  # as in the closing stage
    whole = Segments(data.measured("train"), None, data.instrument)
    batch = whole.gather(torch.arange(min(len(whole), SEGMENTS)))
    batch = batch._replace(values=batch.values[:, : INTERVALS + 1], times=batch.times[:, : INTERVALS + 1])
    parameters = list(dynamics.parameters())
    theta, sizes = parameters_to_vector(parameters).detach(), [p.numel() for p in parameters]
    equations = lambda: WideProblem(dynamics, batch, ROBUST["none"]).equations(theta, sizes)  # noqa: E731
    with torch.no_grad():
        return _median(equations) / work(batch.times)


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
        return _median(lambda: step(1.0), TRIALS)
    return _of_whole(step, TRIALS)


def _part(draw: torch.Tensor, fraction: float) -> torch.Tensor:
    """Return the first indices of a batch."""
    return draw[: math.ceil(len(draw) * fraction)]


def _of_whole(work: Callable[[float], Any], repeats: int = 1) -> float:
    """Return the duration of work on a whole batch; if it is long, extrapolate it from two fractions."""
    small, large = FRACTIONS
    first = _median(lambda: work(small))
    if first < LONG:
        return _median(lambda: work(1.0), repeats)
    second = _timed(lambda: work(large))
    return second + (1 - large) / (large - small) * max(second - first, 0.0)


def _median(work: Callable[[], Any], repeats: int = 1) -> float:
    """Return the median time of a function after a warm-up call."""
    times = []
    while len(times) < 2 or (len(times) <= repeats and sum(times[1:]) < ENOUGH):
        times.append(_timed(work))
    return median(times[1:])


def _timed(work: Callable[[], Any]) -> float:
    begin = time.perf_counter()
    work()
    if torch.cuda.is_initialized():
        torch.cuda.synchronize()
    return time.perf_counter() - begin
