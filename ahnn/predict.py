"""Predict with learned dynamics: `python -m ahnn.predict run=DIR start=FILE duration=1d output=orbit.csv`.

run=DIR             a run folder, or [A,B,C]: the mean of several trainings, with their spread
pretrained=NAME     a model that comes with the package
ckpt=best           the weights: best, last, or a path
start=FILE          first sample of each trajectory in a file (docs/data.md), an element set, or what an
                    assimilation wrote; or numbers in the units of the model: start=[0.5,0], [[0.5,0],[0.7,0]]
start_sd=[..]       its standard deviations, one for each component (of one degree of freedom q and p), or
                    [position,velocity]; else the covariance in FILE, and exact without either
duration=1d         with a unit, or a number in the model's unit of time
step=90min          between two predicted states; that of the training without it
output=FILE         .csv, .parquet, .oem or .xml; without it a summary alone
figure=FILE         .png or .svg
epoch=2024-03-01T12:00:00       of time zero; a start with dates has its own
frame=[EME2000,EARTH,UTC]       frame, centre and time system, where neither model nor file says them
"""

from __future__ import annotations

if __name__ == "__main__":  # until `guard` listens, Ctrl-C ends this process without a traceback
    import signal

    signal.signal(signal.SIGINT, signal.SIG_DFL)

import logging
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ahnn.arguments import Positive
from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing

log = logging.getLogger("ahnn")

USAGE = (
    "usage: python -m ahnn.predict run=DIR | pretrained=NAME start=FILE|[numbers] duration=1d [output=FILE]"
)


@dataclass(frozen=True, kw_only=True)
class Asked:
    """The keys of the command; the module's help says what they are."""

    start: str | list[Any]
    duration: str | float
    start_sd: list[Positive] | None = None
    run: str | list[str] | None = None
    pretrained: str | None = None
    ckpt: str = "best"
    step: str | float | None = None
    output: str | None = None
    figure: str | None = None
    epoch: str | None = None
    frame: str | list[str] | None = None


def predict(arguments: list[str]) -> None:
    """Predict, write what is asked for and show a summary.

    Raises:
        UserError: no such run, starts that are no states of it, or an output that cannot be written.
        TrainingError: a predicted state is not finite.
    """
    with importing():
        from ahnn.cli.pairs import named_runs, read_pairs
        from ahnn.data.reference import Reference
        from ahnn.data.starts import referred, starts
        from ahnn.errors import UserError
        from ahnn.evaluation.terminal import show
        from ahnn.prediction import amounts, output, together
        from ahnn.prediction.kernel import require_finite_prediction
        from ahnn.prediction.summary import summary, warning

    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    asked = read_pairs(arguments, Asked, USAGE)
    runs = named_runs(asked.run, asked.pretrained, asked.ckpt)
    space, clock = runs[0].space, runs[0].space.units.time
    named = ", ".join(asked.frame) if isinstance(asked.frame, list) else asked.frame or ""
    ours = Reference.of(space.frame).chosen(Reference.of(named)).since(asked.epoch)
    begin = starts(asked.start, space, ours, sd=asked.start_sd)
    if asked.epoch is not None and begin.reference.epoch is not None:
        message = f"epoch: expected none, since the file of the start has its own; received {asked.epoch}"
        raise UserError(message)
    begin = referred(begin, ours)
    total = amounts.duration(asked.duration, "duration", clock)
    step = runs[0].dt if asked.step is None else amounts.duration(asked.step, "step", clock)
    times = amounts.grid(total, step)
    if asked.output is not None:
        output.require_output(Path(asked.output), begin, space)
    if asked.figure is not None:
        output.require_figure(Path(asked.figure))
    if asked.output is not None and isinstance(asked.start, str):
        output.require_other(Path(asked.output), Path(asked.start))
    if not all(run.uncertainty for run in runs):  # the mean of what some know would be of nobody
        runs = [replace(run, uncertainty=None) for run in runs]
    text, known = "predicting with {}".format, begin.covariances
    found = together(
        [run.predict(begin.states, times, text(run.folder.name), start_covariance=known) for run in runs]
    )
    require_finite_prediction(found, clock)
    title = " + ".join(run.folder.name for run in runs)
    if asked.output is not None:
        output.write(Path(asked.output), found, begin, space)
    if asked.figure is not None:
        output.draw(Path(asked.figure), found, space, title)
    show(summary(found, begin, space, title))
    if known is not None and not runs[0].uncertainty:
        what = "the start" if len(runs) == 1 else "the start and of what the runs differ by"
        log.warning("1 sigma: that of %s; how well the dynamics are known these weights do not say", what)
    if remark := warning(found, begin, space):
        log.warning(remark)


def main() -> None:
    """Entry point of `python -m ahnn.predict` and `ahnn-predict`."""
    run_command(predict, __doc__)


if __name__ == "__main__":
    main()
