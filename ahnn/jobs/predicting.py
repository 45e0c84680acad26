"""Prediction job: input, propagation, output and summary."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from ahnn.arguments import Finite, Positive, Within
from ahnn.data.starts import Starts
from ahnn.errors import UserError
from ahnn.evaluation.terminal import show
from ahnn.jobs.asked_starts import asked_starts
from ahnn.jobs.control_times import moments_of
from ahnn.jobs.named import named_runs, opened
from ahnn.jobs.predicting_blocks import blocks_of, predict_block
from ahnn.loading import judged_training
from ahnn.prediction import durations, output
from ahnn.prediction.many_trajectories import finite_prediction, joined
from ahnn.prediction.propagation import Prediction, require_room
from ahnn.prediction.summary import nonlinear_warnings, summary, warning
from ahnn.prediction.turned_prediction import turned_prediction
from ahnn.progress import track
from ahnn.runs import Run
from ahnn.workers import Workers

log = logging.getLogger("ahnn")


@dataclass(frozen=True, kw_only=True)
class PredictionRequest:
    """Options of `python -m ahnn.predict`, described in its help."""

    start: str | list[Any]
    duration: str | float
    start_sd: list[Positive] | None = None
    controls: str | list[Finite] | Finite | None = None
    run: str | list[str] | None = None
    pretrained: str | None = None
    ckpt: str = "best"
    step: str | float | None = None
    output: str | None = None
    covariances: bool = False
    samples: Annotated[int, Within(2)] | None = None
    output_frame: Literal["GCRF", "EME2000"] | None = None
    figure: str | None = None
    workers: int | str | None = None
    epoch: str | None = None
    frame: str | list[str] | None = None


def predict(asked: PredictionRequest) -> None:
    """Predict, write the requested files and show a summary.

    Raises:
        UserError: a missing run, invalid starts, or an output that cannot be written.
        TrainingError: every trajectory has predicted states that are not finite.
    """
    if asked.covariances and asked.output is None:
        message = "covariances: expected output=FILE, a table to contain them; received none. Add output="
        raise UserError(message)
    asked = replace(asked, run=opened(asked.run))
    workers = None if asked.workers is None else Workers.of(asked.workers)
    if workers is not None:
        workers.require_installed()
    runs = named_runs(asked.run, asked.pretrained, asked.ckpt)
    space, clock = runs[0].space, runs[0].space.units.time
    begin = asked_starts(asked.start, asked.start_sd, asked.epoch, asked.frame, space)
    total = durations.duration(asked.duration, "duration", clock)
    step = runs[0].dt if asked.step is None else durations.duration(asked.step, "step", clock)
    times = durations.grid(total, step)
    moments = moments_of(asked.controls, begin, times, runs[0])
    at_start = Prediction(begin.times.new_zeros(1), begin.states.unsqueeze(1))
    _, aimed = turned_prediction(at_start, begin, asked.output_frame, space)  # a mistake costs no prediction
    if asked.output is not None:
        output.require_output(Path(asked.output), aimed, space)
    if asked.figure is not None:
        output.require_figure(Path(asked.figure))
    if asked.output is not None and isinstance(asked.start, str):
        output.require_other(Path(asked.output), Path(asked.start))
    blocks = blocks_of(asked.run, asked.pretrained, asked.ckpt, begin, moments, asked.samples or 0)
    require_room(len(begin.states), begin.states.shape[1], times, runs[0].dt)
    if workers is None:
        title = f"predicting {len(begin.states):,} trajectories"
        parts = [*map(predict_block, track(blocks, title, len(blocks)) if len(blocks) > 1 else blocks)]
    else:
        parts = workers.map(predict_block, blocks)
    found, begin = finite_prediction(joined(parts).at(moments.chosen, times), begin, clock)
    found, begin = turned_prediction(found, begin, asked.output_frame, space)
    title, from_numbers = " + ".join(run.folder.name for run in runs), not isinstance(asked.start, str)
    remarks = [
        *(judged_training(run.folder) for run in runs),
        _of_the_start_only(begin, runs),
        warning(found, begin, space, from_numbers=from_numbers),
        *nonlinear_warnings(found, begin, space),
    ]
    remarks = [*filter(None, remarks)]
    if asked.output is not None:
        said = [*remarks, *_unfinished(runs)]
        output.write(Path(asked.output), found, begin, space, said, correlated=asked.covariances)
    if asked.figure is not None:
        output.draw(Path(asked.figure), found, begin, space, title)
    show(summary(found, begin, space, title))
    for remark in remarks:
        log.warning("%s", remark)


def _of_the_start_only(begin: Starts, runs: Sequence[Run]) -> str | None:
    """Return a remark on standard deviations without an uncertainty of the dynamics; None otherwise."""
    if begin.covariances is None or all(run.uncertainty for run in runs):
        return None
    what = "the start" if len(runs) == 1 else "the start and the differences between the runs"
    return f"1 sigma: from {what} only; these weights carry no uncertainty in the dynamics"


def _unfinished(runs: Sequence[Run]) -> list[str]:
    """Return the warnings about trainings that ended before their optimum, which loading has shown."""
    known = [(run.folder.name, run.uncertainty.unfinished) for run in runs if run.uncertainty]
    return [f"run {name}: {warned}" for name, warned in known if warned and len(known) == len(runs)]
