"""When a prediction under controls steps, so that no step crosses a jump of one."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.data.files.control_table import ControlTable, read_controls
from ahnn.data.starts import Starts
from ahnn.errors import UserError
from ahnn.runs import Run

log = logging.getLogger("ahnn")
NEAR = 1e-9
"""Two times are one where they differ by less than this part of the span."""


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


def moments_of(given: str | list[float] | float | None, begin: Starts, times: Tensor, run: Run) -> Moments:
    """Return when a prediction steps.

    Args:
        given: a file with controls over time, or those that are held all the time; None without.
        begin: the starts.
        times: (K,) of the prediction, from the start on.
        run: a trained model.

    Raises:
        UserError: controls that are missing or none, or starts at several times under forces of time.
    """
    every = torch.arange(len(times))
    if not run.dynamics.clock:
        if given is not None:
            message = (
                f"controls: expected none for {run.folder.name}, whose forces take none; received {given}"
            )
            raise UserError(message)
        return Moments(times, every)
    since = begin.times[:1]
    if bool((begin.times != since).any()):
        message = (
            "start: expected states of one time, since forces depend on it; received times "
            f"{begin.times.tolist()}. Predict them one by one"
        )
        raise UserError(message)
    times = times + since
    if not run.space.controls:
        return Moments(times, every)
    if isinstance(given, str):
        table = read_controls(Path(given).expanduser(), run.space)
    else:
        held = given if isinstance(given, list) else [] if given is None else [given]
        table = ControlTable(since, torch.tensor([held], dtype=torch.float64))
    if table.values.shape[-1] != len(run.space.controls):
        names = ", ".join(run.space.controls)
        message = (
            f"controls: expected a FILE with time and {names}, or numbers that are held; received {given}"
        )
        raise UserError(message)
    if isinstance(given, str) and table.times[-1] < times[-1] - NEAR * (times[-1] - times[0]):
        told = given, float(table.times[-1]), float(times[-1])
        log.warning("controls: the last of %s, at %g, are held to the end, at %g", *told)
    whole = merged(times, table.times)
    chosen = torch.searchsorted(whole, times)
    return Moments(whole, chosen, ControlTable(whole, table.at(whole), table.linear))


def merged(times: Tensor, others: Tensor) -> Tensor:
    """Return times (K,) and those of others between them, increasing, each once."""
    near = NEAR * float(times[-1] - times[0])
    after = torch.searchsorted(times, others).clamp(1, len(times) - 1)
    gap = torch.minimum((others - times[after - 1]).abs(), (times[after] - others).abs())
    inside = (others > times[0]) & (others < times[-1]) & (gap > near)
    return torch.cat((times, others[inside])).sort().values
