"""Controls as a user names them, and the times at which a prediction steps under them."""

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
"""The path of a file with controls over time, or those that are held all the time; None without."""


class Moments(NamedTuple):
    """When a prediction steps, so that no step crosses a jump of a control.

    Attributes:
        times: (T,) on the clock of the forces, those of the prediction among them.
        chosen: (K,) which of them are the prediction's.
        controls: at the times; None where nothing is controlled.
    """

    times: Tensor
    chosen: Tensor
    controls: ControlTable | None = None


def moments_of(given: Controls, begin: Starts, times: Tensor, run: Run) -> Moments:
    """Return when a prediction steps.

    Args:
        given: controls.
        begin: the starts.
        times: (K,) of the prediction, from the start on.
        run: a trained model.

    Raises:
        UserError: controls that are missing or none, or starts at several times under forces of time.
    """
    every, since = torch.arange(len(times)), begin.times[:1]
    if run.dynamics.clock and bool((begin.times != since).any()):
        message = (
            "start: expected states of one time, since forces depend on it; received times "
            f"{begin.times.tolist()}. Predict them one by one"
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
    """Return controls over time; None of a model without.

    Args:
        given: controls.
        since: when those that are held all the time begin.
        run: a trained model.

    Raises:
        UserError: controls that are missing or none, or of a model without.
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
            f"controls: expected a FILE with time and {', '.join(names)}, or numbers that are held; received "
            f"{given}"
        )
        raise UserError(message)
    return ControlTable.of([since], [held])


def control_names(run: Run) -> tuple[str, ...]:
    """Return the names of the controls that the forces of a model take."""
    return run.space.controls if run.dynamics.clock > 1 else ()


def warn_of_the_end(given: Controls, table: ControlTable, time: float, near: float = 0.0) -> None:
    """Say that the last controls of a file were held, where it ends before a time."""
    if isinstance(given, str) and table.times[-1] < time - near:
        told = given, float(table.times[-1]), time
        log.warning("controls: the last of %s, at %g, are held to the end, at %g", *told)
