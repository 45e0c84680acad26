"""What do the steps of an ensemble trained at once cost, in steps of one member?

    python benchmarks/bench_members.py experiment=spring recipe=first_order [--members 8] [--seconds 20]

The words are those of `python -m ahnn.train`. For each objective of the training, optimiser steps of one
member and of all members alternate, batches included, for so many seconds. Printed are the medians of wall
time and processor time, and the ratios. Other programs on the machine change the wall time, and the ratio of
processor times little.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, cast

from ahnn.cli.compose import compose_job
from ahnn.cli.ensemble_training import prepare_members
from ahnn.cli.preflight import quiet
from ahnn.jobs.fitting import calibrate
from ahnn.models import AbstractModel, EnsembleModel


def solo(model: AbstractModel, objective: Any, batches: Any, optimizer: Any) -> Callable[[], None]:
    """Return a step of one member."""
    stepper = model.stepper_for(optimizer)

    def step() -> None:
        loss = stepper.step(objective, model.loss, model.dynamics, next(batches), optimizer)
        if stepper.automatic:
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()

    return step


def at_once(model: EnsembleModel, objectives: list[Any], batches: Any, optimizers: Any) -> Callable[[], None]:
    """Return a step of all members."""

    def step() -> None:
        loss = model.losses(objectives, next(batches), optimizers)
        if model.automatic_optimization:
            optimizers.zero_grad()
            loss.backward()
            optimizers.step()

    return step


def timed(work: Callable[[], None]) -> tuple[float, float]:
    """Return wall and processor time of a call, in seconds."""
    wall, used = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - used


def row(name: str, one: Callable[[], None], every: Callable[[], None], seconds: float) -> str:
    """Return the times of both kinds of steps, as a line."""
    for _ in range(3):
        one()
        every()
    found: list[tuple[float, ...]] = []
    until = time.monotonic() + seconds
    while time.monotonic() < until or len(found) < 5:
        found.append((*timed(one), *timed(every)))
    wall, used, walls, uses = (1e3 * median(column) for column in zip(*found, strict=True))
    return (
        f"{name}: one member {wall:.1f} ms ({used:.1f} ms of processor time), all at once {walls:.1f} ms "
        f"({uses:.1f} ms): {walls / wall:.2f} times the time, {uses / used:.2f} times the processor time, "
        f"{len(found)} pairs"
    )


def main() -> None:
    """Print a line for each objective."""
    kind = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=kind)
    parser.add_argument("words", nargs="+")
    parser.add_argument("--members", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=20.0)
    asked = parser.parse_args()
    with TemporaryDirectory() as folder:
        words = [*asked.words, f"members={asked.members}", "logger=none"]
        cfg = compose_job(words, Path(folder, "run"))
        quiet()
        prepared = prepare_members(cfg)
    calibrate(prepared)
    model, data = cast(EnsembleModel, prepared.model), prepared.data
    first, grouped = model.models[0], data.train_dataloader()
    data.group(data.orders[:1])
    alone = data.train_dataloader()
    parameters = sum(p.numel() for p in first.dynamics.parameters())
    print(f"{asked.members} members of {parameters} parameters, {data.batch_size} windows a step", flush=True)
    for k, phase in enumerate(first.curriculum.phases):
        objectives = [one.curriculum.phases[k].objective for one in model.models]
        optimizers = model.optimizers_of_all()
        own = first.optimisation.optimizer(first.dynamics.parameters())
        of_one = solo(first, phase.objective, map(alone.gather, itertools.cycle(alone.batches())), own)
        of_all = at_once(
            model, objectives, map(grouped.gather, itertools.cycle(grouped.batches())), optimizers
        )
        print(row(type(phase.objective).__name__, of_one, of_all, asked.seconds), flush=True)


if __name__ == "__main__":
    main()
