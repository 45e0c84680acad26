"""Members of a batch at times of their own: one call of an estimator for steps of different lengths."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, cast

from torch import Tensor

from ahnn.dynamics.flow_at_time import at, of_members
from ahnn.dynamics.transition import transition
from ahnn.estimation.estimator import S
from ahnn.measurements import Measurement, Position, State, Time, periods, residual
from ahnn.types import Flow, TimeStep

TIMELESS = (Position, State)
"""Models that see the same at any time; filters know them by their class."""


class MemberFlow(NamedTuple):
    """A flow of which each of B members takes a step of its own, from a time of its own.

    Its own time step is the fraction of these steps: 1 takes them whole.

    Attributes:
        flow: any flow without controls.
        times: (B,) at which the steps begin.
        lengths: (B,) of the steps.
    """

    flow: Flow
    times: Tensor
    lengths: Tensor

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states (B S, D) after the steps; the S states of a member follow one another."""
        return at(self.flow, self.times)(x, dt * of_members(self.lengths.unsqueeze(-1), len(x)).squeeze(-1))

    def transition(self, x: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """Return the states (B, D) after the steps, and the state transitions (B, D, D)."""
        return transition(at(self.flow, self.times), x, dt * self.lengths)


class MemberMeasurement:
    """A measurement model that sees each of B members at a time of its own.

    Args:
        model: of the measurement.
        times: (B,).
    """

    def __init__(self, model: Measurement, times: Tensor) -> None:
        self.model, self.names, self.units = model, model.names, model.units
        self.periods, self.times = periods(model), times

    def __call__(self, x: Tensor, t: Time) -> Tensor:  # noqa: ARG002 - members have their own
        """Return the measurements (B, ..., M) of the states x (B, ..., D)."""
        return self.model(x, self.times.reshape(-1, *(1,) * (x.ndim - 2)).expand(x.shape[:-1]))

    def residual(self, y: Tensor, y_pred: Tensor) -> Tensor:
        """Return y - y_pred as the model has it."""
        return residual(self.model, y, y_pred)


def measured_at(model: Measurement, times: Tensor) -> Measurement:
    """Return a model that sees B members at times (B,); one that asks for no time comes back as it is."""
    return model if type(model) in TIMELESS else MemberMeasurement(model, times)


def member_rows(state: S, chosen: Tensor) -> S:
    """Return the state of some members, by their numbers or a mask (B,); what all share stays."""
    return _each(state, lambda part: part[chosen] if part.ndim else part)


def put_rows(state: S, chosen: Tensor, part: S) -> None:
    """Write the state of some members, by their numbers or a mask (B,), into that of all, in place."""
    for whole, own in zip(_tensors(state), _tensors(part), strict=True):
        if whole.ndim:
            whole[chosen] = own


def empty_rows(state: S, count: int) -> S:
    """Return a state of so many members like one of B, whose numbers mean nothing yet."""
    return _each(state, lambda part: part.new_empty(count, *part.shape[1:]) if part.ndim else part)


def _each(state: S, work: Callable[[Tensor], Tensor]) -> S:
    """Return a state of which work has changed each tensor."""
    named: dict[str, Any] = cast(Any, state)._asdict()
    for name, part in named.items():
        named[name] = _each(cast(Any, part), work) if isinstance(part, tuple) else work(part)
    return state._replace(**named)


def _tensors(state: Any) -> list[Tensor]:
    """Return the tensors of a state, those of inner tuples in their place."""
    return [one for part in state for one in (_tensors(part) if isinstance(part, tuple) else (part,))]
