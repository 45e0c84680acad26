"""Benchmark command: training runs on published tasks, and the table of their scores."""

from __future__ import annotations

import contextlib
import json
import logging
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from ahnn.arguments import Count
from ahnn.cli.early_stops import ended
from ahnn.cli.numbered_draws import SCORE, appearing, finished, run_missing, score
from ahnn.cli.pairs import divided, read_pairs
from ahnn.errors import Occupied, TrainingError, UserError, WrongUsage
from ahnn.evaluation.terminal import show
from ahnn.files import require_writable, write_atomically
from ahnn.fitting import fit
from ahnn.tasks import TASKS, Draw, FieldTask, Predict, table

log = logging.getLogger("ahnn")


@dataclass(frozen=True)
class BenchmarkRequest:
    """Options of a benchmark command besides task names."""

    draws: Count = 10
    jobs: Count = 1
    models: list[str] = field(default_factory=list)
    output: str = "runs/benchmark"
    only: Count | None = None  # a single draw, counted from 1: set for worker processes


class DrawnTraining(NamedTuple):
    """One training run on a task: model, draw, and folder."""

    task: str
    model: str
    draw: int
    folder: Path


def benchmark(arguments: list[str]) -> None:
    """Carry out and score unfinished training runs, and show the table.

    Raises:
        UserError: unknown tasks or models, or a folder with other content.
        TrainingError: some training runs failed; all other runs are in the table.
    """
    names, pairs = divided(arguments)
    asked = read_pairs(pairs or ["jobs=1"], BenchmarkRequest)
    chosen = tasks_of([str(name) for name in names])
    plan = [*trainings(chosen, asked)]
    if asked.only is not None:
        for training in plan:
            one(training)
        return
    require_writable(Path(asked.output))
    with ended(lambda: "repeat the command to resume"):
        failed = run(plan, asked)
    for name, task in chosen.items():
        show(table(name, task, scores_of(name, plan)))
    if failed:
        places = ", ".join(f"{t.task}/{t.model} {t.draw + 1}" for t in failed)
        message = f"benchmark: {len(failed)} of {len(plan)} training runs failed, see above: {places}"
        raise TrainingError(message)


def tasks_of(names: list[str]) -> dict[str, FieldTask]:
    """Return tasks by name; raises UserError for no or unknown names."""
    if unknown := [name for name in names if name not in (*TASKS, "all")]:
        message = f"benchmark: expected one or more of {', '.join(TASKS)}, or all; received {unknown[0]}"
        raise UserError(message)
    if not names:
        message = "received no name"
        raise WrongUsage(message)
    return {name: task for name, task in TASKS.items() if name in names or "all" in names}


def trainings(tasks: dict[str, FieldTask], asked: BenchmarkRequest) -> Iterator[DrawnTraining]:
    """Yield the training runs of tasks, draw by draw; raises UserError for an unknown model."""
    known = list(dict.fromkeys(model for task in tasks.values() for model in task.models))
    if unknown := [model for model in asked.models if model not in known]:
        message = f"models: expected one or more of {', '.join(known)}; received {unknown[0]}"
        raise UserError(message)
    draws = range(asked.draws) if asked.only is None else [asked.only - 1]
    for name, task in tasks.items():
        for draw in draws:
            for model in task.models:
                if not asked.models or model in asked.models:
                    yield DrawnTraining(
                        name, model, draw, Path(asked.output, name, model, f"draw_{draw + 1}")
                    )


def run(plan: list[DrawnTraining], asked: BenchmarkRequest) -> list[DrawnTraining]:
    """Run the unfinished training runs, each in a separate process; return the failed runs."""
    done = sum(map(finished, plan))
    log.info("benchmark: %d training runs in %s, %d of them finished", len(plan), asked.output, done)

    def words(part: Sequence[DrawnTraining]) -> list[str]:
        (training,) = part
        own = [training.task, f"models=[{training.model}]", f"only={training.draw + 1}"]
        return ["ahnn.benchmark", *own, f"output='{asked.output}'"]

    return run_missing(plan, words, asked.jobs)


def one(training: DrawnTraining) -> None:
    """Train and score one draw in this process; its folder appears atomically."""
    import torch

    task = TASKS[training.task]
    drawn = task.draw(training.draw)
    with contextlib.suppress(Occupied), appearing(training.folder) as place:
        begun = time.process_time()
        own = (*drawn.options, f"data.split={list(drawn.split)}", f"seed={training.draw}")
        options = [*task.models[training.model], *own]
        fitted = fit(drawn.data, drawn.space, options, folder=place / "run")
        seconds = time.process_time() - begun  # process time, independent of other load
        with torch.no_grad():
            found = scored(drawn, lambda x, steps, dt: fitted.rollout(x, steps, dt))
        found["seconds"] = round(seconds, 1)
        write_atomically(place / SCORE, json.dumps(found).encode())
        name = f"{training.task}, {training.model}, draw {training.draw + 1}"
        log.info("%s: %.3g in %.0f s", name, found["score"], seconds)


def scored(drawn: Draw, predict: Predict) -> dict[str, float]:
    """Return scores of predictions by name, and the floor if available.

    A diverged prediction has an infinite score.
    """
    scores = {"score": drawn.score, **drawn.also}
    found = {name: score(predict) for name, score in scores.items()}
    found |= {} if drawn.floor is None else {"floor": drawn.floor()}
    return {name: math.inf if math.isnan(value) else value for name, value in found.items()}


def scores_of(name: str, plan: list[DrawnTraining]) -> dict[str, list[dict[str, float]]]:
    """Return the scores on a task by model name."""
    found: dict[str, list[dict[str, float]]] = {}
    for training in plan:
        if training.task == name and finished(training):
            found.setdefault(training.model, []).append(score(training))
    return found
