"""Blocks of starts: one process predicts them in turn, or several share them, with the same results."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import NamedTuple

from torch import Tensor

from ahnn.data.starts import Starts
from ahnn.jobs.control_times import Moments
from ahnn.jobs.named import named_runs
from ahnn.prediction import together
from ahnn.prediction.propagation import Prediction
from ahnn.runs import Run

TOGETHER = 250
"""Number of starts in a block. Decisions for a whole block, such as the order of a quadrature, therefore do
not depend on the number of workers."""


class StartBlock(NamedTuple):
    """Starts that one process predicts.

    Attributes:
        runs: run folders; empty for a shipped model.
        pretrained: name of a shipped model.
        ckpt: weights to use: `best`, `last`, or a path.
        states: (B, D) starts.
        covariances: (B, D, D) covariances of the starts, or None.
        moments: time steps and controls.
        is_only: whether there is no other block.
        samples: number of sampled paths from each start; 0 for first-order covariances.
    """

    runs: tuple[str, ...]
    pretrained: str | None
    ckpt: str
    states: Tensor
    covariances: Tensor | None
    moments: Moments
    is_only: bool
    samples: int


def blocks_of(
    run: str | list[str] | None,
    pretrained: str | None,
    ckpt: str,
    begin: Starts,
    moments: Moments,
    samples: int,
) -> list[StartBlock]:
    """Divide the starts of a prediction with one run, several runs or a shipped model."""
    _loaded.cache_clear()  # a run folder, or the working directory, may have changed in the meantime
    runs = () if run is None else tuple(run) if isinstance(run, list) else (run,)
    states = begin.states.split(TOGETHER)
    known = [None] * len(states) if begin.covariances is None else begin.covariances.split(TOGETHER)
    of_runs = runs, pretrained, ckpt
    return [
        StartBlock(*of_runs, *part, moments, len(states) == 1, samples)
        for part in zip(states, known, strict=True)
    ]


def predict_block(block: StartBlock) -> Prediction:
    """Return the mean prediction of all runs; raises the same errors as `Run.predict`."""
    controls = block.moments.controls
    found = []
    for run in _loaded(block.runs, block.pretrained, block.ckpt):
        description = f"predicting with {run.folder.name}" if block.is_only else None
        asked = {"controls": controls and controls.values, "linear": controls is not None and controls.linear}
        known, asked["samples"] = block.covariances, block.samples
        found.append(
            run.predict(block.states, block.moments.times, description, start_covariance=known, **asked)
        )
    return together(found)


@cache
def _loaded(runs: tuple[str, ...], pretrained: str | None, ckpt: str) -> list[Run]:
    """Return runs, all with or all without a parameter covariance: a mean over only some is meaningless."""
    found = named_runs(list(runs) or None, pretrained, ckpt)
    if not all(run.uncertainty for run in found):
        return [replace(run, uncertainty=None) for run in found]
    return found
