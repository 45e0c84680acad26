"""Members with individual times: one estimator call for steps of different lengths."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, cast

from torch import Tensor

from ahnn.dynamics.flow_at_time import at, of_members
from ahnn.dynamics.transition import transition
from ahnn.estimation.estimator import S
from ahnn.measurements import DerivedMeasurement, Measurement, Position, State, Time
from ahnn.types import Flow, TimeStep

TIMELESS = (Position, State)
"""Time-independent measurement models, which filters recognise by class."""


class MemberFlow(NamedTuple):
    """Flow with an individual step length and start time for each of B members.

    The time step passed to it is a fraction of these lengths; 1 gives full steps.

    Attributes:
        flow: any flow without controls.
        times: (B,) start times of the steps.
        lengths: (B,) step lengths.
    """

    flow: Flow
    times: Tensor
    lengths: Tensor

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states (B S, D) after the steps; the S states of a member are consecutive."""
        return at(self.flow, self.times)(x, dt * of_members(self.lengths.unsqueeze(-1), len(x)).squeeze(-1))

    def transition(self, x: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """Return the states (B, D) after the steps, and the state transitions (B, D, D)."""
        return transition(at(self.flow, self.times), x, dt * self.lengths)


def measured_at(model: Measurement, times: Tensor) -> Measurement:
    """Bind a model to times (B,) of B members; a time-independent model is returned unchanged."""

    def measured(x: Tensor, _t: Time) -> Tensor:
        return model(x, times.reshape(-1, *(1,) * (x.ndim - 2)).expand(x.shape[:-1]))

    return model if type(model) in TIMELESS else DerivedMeasurement(model, measured)


def member_rows(state: S, chosen: Tensor) -> S:
    """Select the state of members by index or mask (B,); shared tensors are kept."""
    return _each(state, lambda part: part[chosen] if part.ndim else part)


def put_rows(state: S, chosen: Tensor, part: S) -> None:
    """Write the state of some members, by index or mask (B,), into the state of all members, in place."""
    for whole, own in zip(_tensors(state), _tensors(part), strict=True):
        if whole.ndim:
            whole[chosen] = own


def empty_rows(state: S, count: int) -> S:
    """Allocate a state of a given number of members, with uninitialised values."""
    return _each(state, lambda part: part.new_empty(count, *part.shape[1:]) if part.ndim else part)


def _each(state: S, work: Callable[[Tensor], Tensor]) -> S:
    """Apply a function to each tensor of a state."""
    named: dict[str, Any] = cast(Any, state)._asdict()
    for name, part in named.items():
        named[name] = _each(cast(Any, part), work) if isinstance(part, tuple) else work(part)
    return state._replace(**named)


def _tensors(state: Any) -> list[Tensor]:
    """Return the tensors of a state and of its nested tuples, in order."""
    return [one for part in state for one in (_tensors(part) if isinstance(part, tuple) else (part,))]
