"""Where an assimilation begins: a belief about one state, and when it holds."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.assimilation.stream_clock import StreamClock
from ahnn.data.files.epochs import spelled
from ahnn.data.reference import Reference
from ahnn.data.starts import Starts
from ahnn.deviations import state_deviations
from ahnn.errors import UserError
from ahnn.estimation import Belief, initial_belief
from ahnn.types import Space

log = logging.getLogger("ahnn")

Carry = Callable[[Tensor, Tensor, Tensor], Tensor]
"""From states (1, D), times (2,) and covariances (1, D, D) at the first of them to those at the second."""


class Begin(NamedTuple):
    """A clock, and when on it a start holds.

    Attributes:
        clock: of the stream.
        time: of the start.
        reference: of the estimates.
    """

    clock: StreamClock
    time: float
    reference: Reference


def belief_of(
    found: Starts, deviations: list[float] | None, space: Space, carry: Carry, *, many: bool = False
) -> Belief:
    """Return the belief about the one state of some starts, or those about all of many objects.

    Args:
        found: the starts.
        deviations: standard deviations where the start has no covariance.
        space: what the numbers of a state mean.
        carry: takes the covariance of an earlier state to the time of the start.
        many: whether there are many objects.

    Raises:
        UserError: several states of one object, or no covariance.
    """
    if len(found.states) != 1 and not many:
        names = ", ".join(found.names[:5]) + (", .." if len(found.names) > 5 else "")
        remedy = "Keep one of them, or name the column of objects, objects=COLUMN"
        message = f"start: expected one state; received {len(found.states)}: {names}. {remedy}"
        raise UserError(message)
    covariance = found.covariances
    if covariance is None:
        covariance = state_deviations(deviations, space, "start_sd").square().diag()
    elif found.since is not None and many:
        message = (
            "start: expected covariances of the last states; received those of earlier ones. Add start_sd="
        )
        raise UserError(message)
    elif found.since is not None:
        times, states = found.since
        covariance = carry(states, torch.cat((times, found.times)), covariance)
        span = f"{float(found.times - times):g} {space.units.time}"
        log.info("start: its covariance is of a state %s before it, and carried on by the model", span)
    try:
        return initial_belief(found.states, covariance)
    except ValueError as error:
        message = f"start: expected a state with its covariance; received another ({error})"
        raise UserError(message) from error


def begin(found: Starts, ours: Reference, time: float | None, unit: str) -> Begin:
    """Return the clock of a stream and when its start holds.

    Args:
        found: the start of one state.
        ours: reference of the model, with the epoch of time zero where that is known.
        time: at which the start holds, as a user says; None without.
        unit: of time.

    Raises:
        UserError: two times of one start.
    """
    own, held = found.reference, float(found.times[0])
    whole = ours.filled(own)
    clock = StreamClock(unit, None, whole.clock or "UTC")
    if own.epoch is None:
        if time is not None and held not in (0.0, time):
            message = (
                f"time: expected none, since the file of the start has its own, {held:g}; received {time:g}"
            )
            raise UserError(message)
        return Begin(clock._replace(zero=whole.epoch), held if time is None else time, whole)
    moment = own.on(clock.system)
    if ours.epoch is None:  # zero is where the user has the start, or the start itself
        zero = clock.after(moment.epoch, held - (time or 0.0))
        clock = clock._replace(zero=zero, dated=time is None)
        return Begin(clock, time or 0.0, whole._replace(epoch=zero))
    if time is not None:
        said = spelled(clock.after(moment.epoch, held), utc=clock.system == "UTC")
        message = f"time: expected none, since the file of the start has its own, {said}; received {time:g}"
        raise UserError(message)
    return Begin(clock._replace(zero=whole.epoch), clock.between(whole.epoch, moment.epoch) + held, whole)
