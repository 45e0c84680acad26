"""Predictions of many trajectories: blocks are joined; non-finite trajectories are reported and omitted."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from itertools import compress

import torch

from ahnn.data.starts import Starts
from ahnn.errors import TrainingError
from ahnn.prediction.propagation import Prediction

log = logging.getLogger("ahnn")

NAMED = 5
"""Number of trajectories that are reported individually."""


def joined(parts: Sequence[Prediction]) -> Prediction:
    """Join the predictions of several blocks of starts, in the given order."""
    columns = [
        None if rows[0] is None else torch.cat(rows) for rows in zip(*(p[1:] for p in parts), strict=True)
    ]
    return Prediction(parts[0].times, *columns)  # pyright: ignore[reportArgumentType]


def finite_prediction(prediction: Prediction, starts: Starts, unit: str) -> tuple[Prediction, Starts]:
    """Return the trajectories whose states and covariances are finite, and report the others.

    Raises:
        TrainingError: no trajectory is finite; the message names the first failure and its time.
    """
    wrong = ~prediction.states.isfinite().all(-1)
    if prediction.covariances is not None:
        wrong |= ~prediction.covariances.isfinite().all(-1).all(-1)
    if not bool(wrong.any()):
        return prediction, starts
    lost, sound = wrong.any(1).nonzero()[:, 0].tolist(), ~wrong.any(1)
    after = {k: f"{float(prediction.times[wrong[k].nonzero()[0, 0]]):g} {unit}" for k in lost}
    if len(lost) == len(wrong):
        first = min(lost, key=lambda k: int(wrong[k].nonzero()[0]))
        message = (
            f"prediction: expected finite states; received NaN or infinity {after[first]} after start "
            f"{first + 1}. Nothing was written: shorten duration, or check the start and the model"
        )
        raise TrainingError(message)
    for k in lost[:NAMED]:
        log.warning(
            "%s: the prediction is NaN or infinite from %s after the start and is left out",
            starts.names[k],
            after[k],
        )
    if len(lost) > NAMED:
        log.warning(
            "%d more of %d trajectories are left out for the same reason", len(lost) - NAMED, len(wrong)
        )
    rest = [None if part is None else part[sound] for part in prediction[1:]]
    known = None if starts.covariances is None else starts.covariances[sound]
    kept = starts._replace(
        objects=tuple(compress(starts.objects, sound.tolist())),
        states=starts.states[sound],
        times=starts.times[sound],
        covariances=known,
        since=None,
    )
    return Prediction(prediction.times, *rest), kept  # pyright: ignore[reportArgumentType]
