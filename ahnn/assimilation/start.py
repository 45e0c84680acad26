"""Start of an assimilation: initial beliefs and their time."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.assimilation.cells import BadLine
from ahnn.assimilation.stream_clock import StreamClock
from ahnn.data.files.epochs import CODE, instant, spelled
from ahnn.data.reference import Reference
from ahnn.data.starts import Starts
from ahnn.deviations import state_deviations
from ahnn.errors import UserError
from ahnn.estimation import Belief, initial_belief
from ahnn.labels import duration
from ahnn.types import Space

log = logging.getLogger("ahnn")

HEAD = 50
"""Number of lines in which the first date is looked for."""
Carry = Callable[[Tensor, Tensor, Tensor], Tensor]
"""Function of states (1, D), times (2,) and covariances (1, D, D): propagates the latter to the second time.
"""


class Begin(NamedTuple):
    """Clock of a stream and time of the start.

    Attributes:
        clock: clock of the stream.
        time: time of the start.
        reference: reference frame and epoch of the estimates.
    """

    clock: StreamClock
    time: float
    reference: Reference


def belief_of(
    found: Starts, deviations: list[float] | None, space: Space, carry: Carry, *, many: bool = False
) -> Belief:
    """Return the belief of a single start, or the beliefs of many objects.

    Args:
        found: starts found in the input.
        deviations: standard deviations for a start without covariance.
        space: description of the state components.
        carry: propagates the covariance of an earlier state to the time of the start.
        many: whether there are many objects.

    Raises:
        UserError: several states of one object, or no valid covariance.
    """
    if len(found.states) != 1 and not many:
        names = ", ".join(found.names[:5]) + (", .." if len(found.names) > 5 else "")
        remedy = "Keep one of them, or name the column with the object names: objects=COLUMN"
        message = f"start: expected one state; received {len(found.states)}: {names}. {remedy}"
        raise UserError(message)
    covariance = found.covariances
    if covariance is None:
        covariance = state_deviations(deviations, space, "start_sd").square().diag()
    elif found.since is not None and many:
        message = (
            "start: expected covariances of the last states; received covariances of earlier states. Add "
            "start_sd="
        )
        raise UserError(message)
    elif found.since is not None:
        times, states = found.since
        covariance = carry(states, torch.cat((times, found.times)), covariance)
        span = duration(float(found.times - times), space)
        log.info("start: the covariance is propagated by the model from a state %s earlier", span)
    try:
        return initial_belief(found.states, covariance)
    except ValueError as error:
        message = f"start: expected a valid covariance; received an invalid one ({error})"
        raise UserError(message) from error


def begin(found: Starts, ours: Reference, time: float | str | None, unit: str) -> Begin:
    """Determine the clock of a stream and the time of its start.

    Args:
        found: start of one state.
        ours: reference of the model, with the epoch of time zero if known.
        time: time of the start from the user, a number or a date, or None.
        unit: unit of time.

    Raises:
        UserError: contradictory times of one start, or an invalid one.
    """
    if isinstance(time, str):
        time = dated(time, StreamClock(unit, ours.epoch, ours.clock or "UTC"))
    own, held = found.reference, float(found.times[0])
    whole = ours.filled(own)
    clock = StreamClock(unit, None, whole.clock or "UTC")
    if own.epoch is None:
        if time is not None and held not in (0.0, time):
            message = f"time: expected none, since the start file has its own, {held:g}; received {time:g}"
            raise UserError(message)
        return Begin(clock._replace(zero=whole.epoch), held if time is None else time, whole)
    moment = own.on(clock.system)
    if ours.epoch is None:  # the start is at the user's time, or else at time zero
        zero = clock.after(moment.epoch, held - (time or 0.0))
        clock = clock._replace(zero=zero, dated=time is None)
        return Begin(clock, time or 0.0, whole._replace(epoch=zero))
    if time is not None:
        said = spelled(clock.after(moment.epoch, held), utc=clock.system == "UTC")
        message = f"time: expected none, since the start file has its own, {said}; received {time:g}"
        raise UserError(message)
    return Begin(clock._replace(zero=whole.epoch), clock.between(whole.epoch, moment.epoch) + held, whole)


def dated(text: str, clock: StreamClock) -> float:
    """Return the time of a start that is given as a date.

    Raises:
        UserError: an invalid date, or no epoch of time zero.
    """
    if clock.zero is None:
        message = (
            f"time: expected a date together with epoch=, the epoch of time zero; received {text} alone. Add "
            "epoch="
        )
        raise UserError(message)
    try:
        return clock.time(text)
    except BadLine as error:
        raise UserError(str(error)) from error


def begin_fitted(ours: Reference, file: str, unit: str) -> Begin:
    """Return the clock of a stream whose start is fitted; time zero is the model's, or else the first date.

    A model whose forces do not depend on time is the same from any epoch, so the data may define time zero.

    Args:
        ours: reference of the model, with the epoch of time zero if known.
        file: path of the measurements.
        unit: unit of time.
    """
    clock = ours.clock or "UTC"
    if ours.epoch is None and (first := first_date(file, utc=clock == "UTC")) is not None:
        ours = ours._replace(epoch=first, clock=clock)
    return Begin(StreamClock(unit, ours.epoch, clock), 0.0, ours)


def first_date(file: str, *, utc: bool) -> int | None:
    """Return the first epoch with a time of day in the first lines of a file; None if there is none."""
    if not Path(file).is_file():
        return None
    with Path(file).open(encoding="utf-8", errors="replace") as stream:
        lines = [line for line in islice(stream, HEAD) if not line.startswith("#")]
    for found in (one for line in lines for one in CODE.finditer(line) if one["hour"]):
        with suppress(ValueError):
            return instant(found[0], utc=utc)
    return None
