"""Prediction job: input, propagation, output and summary."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ahnn.arguments import Finite, Positive
from ahnn.evaluation.terminal import show
from ahnn.jobs.asked_starts import asked_starts
from ahnn.jobs.control_times import moments_of
from ahnn.jobs.named import named_runs, opened
from ahnn.prediction import durations, output, together
from ahnn.prediction.propagation import require_finite_prediction
from ahnn.prediction.summary import summary, warning

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
    figure: str | None = None
    epoch: str | None = None
    frame: str | list[str] | None = None


def predict(asked: PredictionRequest) -> None:
    """Predict, write the requested files and show a summary.

    Raises:
        UserError: a missing run, invalid starts, or an output that cannot be written.
        TrainingError: a predicted state is not finite.
    """
    runs = named_runs(opened(asked.run), asked.pretrained, asked.ckpt)
    space, clock = runs[0].space, runs[0].space.units.time
    begin = asked_starts(asked.start, asked.start_sd, asked.epoch, asked.frame, space)
    total = durations.duration(asked.duration, "duration", clock)
    step = runs[0].dt if asked.step is None else durations.duration(asked.step, "step", clock)
    times = durations.grid(total, step)
    moments = moments_of(asked.controls, begin, times, runs[0])
    if asked.output is not None:
        output.require_output(Path(asked.output), begin, space)
    if asked.figure is not None:
        output.require_figure(Path(asked.figure))
    if asked.output is not None and isinstance(asked.start, str):
        output.require_other(Path(asked.output), Path(asked.start))
    if not all(run.uncertainty for run in runs):  # a mean over only some of the models would be meaningless
        runs = [replace(run, uncertainty=None) for run in runs]
    known, (whole, chosen, controls) = begin.covariances, moments
    found = together(
        [
            run.predict(
                begin.states,
                whole,
                f"predicting with {run.folder.name}",
                start_covariance=known,
                controls=controls and controls.values,
                linear=controls is not None and controls.linear,
            )
            for run in runs
        ]
    ).at(chosen, times)
    require_finite_prediction(found, clock)
    title = " + ".join(run.folder.name for run in runs)
    if asked.output is not None:
        output.write(Path(asked.output), found, begin, space)
    if asked.figure is not None:
        output.draw(Path(asked.figure), found, space, title)
    show(summary(found, begin, space, title))
    if known is not None and not runs[0].uncertainty:
        what = "the start" if len(runs) == 1 else "the start and the differences between the runs"
        log.warning("1 sigma: from %s only; these weights carry no uncertainty of the dynamics", what)
    if remark := warning(found, begin, space):
        log.warning(remark)
