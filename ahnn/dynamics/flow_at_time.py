"""A flow that depends on time, from an instant on: a map of plain states, as estimators take it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.clock import Clock, extended, reduced
from ahnn.dynamics.transition import transition
from ahnn.errors import UserError
from ahnn.rollouts import clock_of, stepped
from ahnn.types import Flow, TimeStep


def at(flow: Flow, time: float | Tensor) -> Flow:
    """Return a flow from an instant on; one that does not depend on time comes back as it is.

    Raises:
        UserError: a flow with controls, which no clock tells.
    """
    if not clock_of(flow):
        return flow
    own = getattr(flow, "at", None)
    return own(time) if own is not None else Bound(flow, float(time))


class Bound(NamedTuple):
    """A flow of extended states, begun at one time with states of 2n components.

    Attributes:
        flow: which depends on time.
        time: at which its steps begin.
    """

    flow: Flow
    time: float

    def clock(self, x: Tensor) -> Clock:
        """Return the clock of states (B, 2n); raises UserError for a flow with controls."""
        if clock_of(self.flow) > 1:
            message = (
                "flow: expected forces of state and time in an estimator; received some of controls, which "
                "only a rollout is given"
            )
            raise UserError(message)
        t = x.new_full((len(x), 1), self.time)
        return Clock(t, torch.ones_like(t))

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states (B, 2n) after dt."""
        return stepped(self.flow, x, dt, self.clock(x))

    def transition(self, x: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """Return the states (B, 2n) after dt, and the state transitions (B, 2n, 2n)."""
        after, moved = transition(self.flow, extended(x, self.clock(x)), dt)
        return reduced(after, 1), reduced(reduced(moved, 1).mT, 1).mT


class Wrapped(NamedTuple):
    """A flow made of one that depends on time.

    Attributes:
        flow: which depends on time.
        wrap: what makes the other of it.
    """

    flow: Flow
    wrap: Callable[[Flow], Flow]

    @property
    def clock(self) -> int:
        """Clock coordinates of the flow inside."""
        return clock_of(self.flow)

    def at(self, time: float | Tensor) -> Flow:
        """Return the flow from an instant on."""
        return self.wrap(at(self.flow, time))

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states after dt, of a flow that was not told when; raises UserError."""
        del x, dt
        message = "flow: expected the time at which a step begins, on which forces depend; received none"
        raise UserError(message)


def wrapped(flow: Flow, wrap: Callable[[Flow], Flow]) -> Flow:
    """Return what is made of a flow, whether it depends on time or not."""
    return Wrapped(flow, wrap) if clock_of(flow) else wrap(flow)
