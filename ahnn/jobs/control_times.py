"""Controls of predictions, and time steps aligned with their jumps."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.controls import NEAR, ControlTable
from ahnn.data.files.control_table import read_controls
from ahnn.data.starts import Starts
from ahnn.errors import UserError
from ahnn.runs import Run

log = logging.getLogger("ahnn")

Controls = str | list[float] | float | None
"""Path of a control table, or constant controls; None without controls."""


class Moments(NamedTuple):
    """Time steps of a prediction, such that no step crosses a jump of a control.

    Attributes:
        times: (T,) times between which steps are taken, including the output times.
        chosen: (K,) indices of the output times.
        controls: controls at the times; None without controls.
    """

    times: Tensor
    chosen: Tensor
    controls: ControlTable | None = None


def moments_of(given: Controls, begin: Starts, times: Tensor, run: Run) -> Moments:
    """Determine the time steps of a prediction.

    Args:
        given: controls from the user.
        begin: starts of the prediction.
        times: (K,) output times after the start; the first is 0.
        run: a trained model.

    Raises:
        UserError: missing or invalid controls, or starts at different times with time-dependent forces.
    """
    every, since = torch.arange(len(times)), begin.times[:1]
    if run.dynamics.clock and bool((begin.times != since).any()):
        message = (
            "start: expected states at one common time, since forces depend on time; received times "
            f"{begin.times.tolist()}. Predict from one state at a time"
        )
        raise UserError(message)
    times = times + since if run.dynamics.clock else times
    table = known_controls(given, float(since), run)
    if table is None:
        return Moments(times, every)
    warn_of_the_end(given, table, float(times[-1]), NEAR * float(times[-1] - times[0]))
    whole = table.over(times)
    return Moments(whole.times, torch.searchsorted(whole.times, times), whole)


def known_controls(given: Controls, since: float, run: Run) -> ControlTable | None:
    """Return controls over time; None for a model without controls.

    Args:
        given: controls from the user.
        since: start time of constant controls.
        run: a trained model.

    Raises:
        UserError: missing or invalid controls, or controls for a model without them.
    """
    names = control_names(run)
    if not names:
        if given is not None:
            message = (
                f"controls: expected none for {run.folder.name}, whose forces take none; received {given}"
            )
            raise UserError(message)
        return None
    if isinstance(given, str):
        return read_controls(Path(given).expanduser(), run.space)
    held = given if isinstance(given, list) else [] if given is None else [given]
    if len(held) != len(names):
        message = (
            f"controls: expected a FILE with time and {', '.join(names)}, or constant numbers; received "
            f"{given}"
        )
        raise UserError(message)
    return ControlTable.of([since], [held])


def control_names(run: Run) -> tuple[str, ...]:
    """Return the names of the controls used by the forces of a model."""
    return run.space.controls if run.dynamics.clock > 1 else ()


def warn_of_the_end(given: Controls, table: ControlTable, time: float, near: float = 0.0) -> None:
    """Warn if the last controls of a file are held beyond its end."""
    if isinstance(given, str) and table.times[-1] < time - near:
        values = given, float(table.times[-1]), time
        log.warning("controls: the last values of %s, at %g, are held until the end, at %g", *values)
