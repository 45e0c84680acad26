"""Time-dependent flows bound to a start time, which estimators apply to plain states."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.clock import Clock, extended, reduced, reduced_jacobians
from ahnn.controls import NEAR, ControlTable
from ahnn.dynamics.transition import transition
from ahnn.errors import UserError
from ahnn.numbers import Numbers, as_float64
from ahnn.rollouts import clock_of, stepped
from ahnn.types import Flow, TimeStep

NO_TIME = "flow: expected the time at which a step begins, on which forces depend; received none"


def at(flow: Flow, time: float | Tensor) -> Flow:
    """Bind a flow to a start time; an autonomous flow is returned unchanged.

    A flow with controls must be `steered`: otherwise the bound flow raises UserError when it is called.

    Args:
        flow: any flow.
        time: start time, or (B,) start times of B members.
    """
    if not clock_of(flow):
        return flow
    own = getattr(flow, "at", None)
    return own(time) if own is not None else Bound(flow, _instant(time))


def _instant(time: float | Tensor) -> float | Tensor:
    """Return a single time as a number, and times of members unchanged."""
    return time if isinstance(time, Tensor) and time.ndim else float(time)


class Bound(NamedTuple):
    """Flow of extended states, bound to a start time and applied to states of 2n components.

    Attributes:
        flow: time-dependent flow.
        time: start time of its steps, or (B,) one per member.
        controls: values and rates at that time, (m,) each, or (B, m); None for a flow without controls.
    """

    flow: Flow
    time: float | Tensor
    controls: tuple[Tensor, Tensor] | None = None

    def clock(self, x: Tensor) -> Clock:
        """Return the clock of states (B, 2n); raises UserError for unknown controls."""
        if clock_of(self.flow) > 1 and self.controls is None:
            message = (
                "flow: expected forces that depend only on state and time in an estimator; received forces "
                "that depend on controls. `ahnn.dynamics.flow_at_time.steered` supplies the controls"
            )
            raise UserError(message)
        if isinstance(self.time, Tensor):
            t = of_members(self.time.to(x).unsqueeze(-1), len(x))
        else:
            t = x.new_full((len(x), 1), self.time)
        known = Clock(t, torch.ones_like(t))
        if self.controls is None:
            return known
        u, slope = (of_members(part.to(x), len(x)) for part in self.controls)
        return Clock(torch.cat((known.values, u), dim=-1), torch.cat((known.rates, slope), dim=-1))

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states (B, 2n) after dt."""
        return stepped(self.flow, x, dt, self.clock(x))

    def transition(self, x: Tensor, dt: TimeStep) -> tuple[Tensor, Tensor]:
        """Return the states (B, 2n) after dt, and the state transitions (B, 2n, 2n)."""
        after, moved = transition(self.flow, extended(x, self.clock(x)), dt)
        count = clock_of(self.flow)
        return reduced(after, count), reduced_jacobians(moved, count)


def of_members(values: Tensor, count: int) -> Tensor:
    """Expand controls (m,) or (B, m) to `count` states, grouped by the B members.

    Raises:
        UserError: a number of states that does not match the members.
    """
    if values.ndim == 1:
        return values.expand(count, -1)
    if count % len(values):
        message = f"steered: expected states of {len(values)} members, as in the controls; received {count}"
        raise UserError(message)
    return values.repeat_interleave(count // len(values), dim=0)


class Steered(NamedTuple):
    """Flow with prescribed controls, which depends only on time.

    Attributes:
        flow: flow with m controls.
        controls: table for all members, or one per member.
    """

    flow: Flow
    controls: ControlTable

    @property
    def clock(self) -> int:
        """Number of clock coordinates: 1, for time."""
        return 1

    def at(self, time: float | Tensor) -> Flow:
        """Bind the flow to a start time; outside the table the first or last controls apply."""
        times = self.controls.times
        near = NEAR * float(times[-1] - times[0])
        values, rates = self.controls.begun(times.new_tensor([float(time)]), near)
        return Bound(self.flow, float(time), (values[..., 0, :], rates[..., 0, :]))

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Raise UserError: the start time is unknown."""
        raise UserError(NO_TIME)


def steered(flow: Flow, times: Numbers, controls: Numbers, *, linear: bool = False) -> Flow:
    """Bind a flow to prescribed controls, for filters, smoothers and least squares.

    Args:
        flow: learned or known dynamics with m controls, or the result of `wrapped` for such dynamics.
        times: (T,) increasing times.
        controls: (T, m), or (B, T, m) for B members; each held until the next sample.
        linear: whether controls are interpolated linearly instead.

    A step must not extend beyond the next sample of a held control.

    Raises:
        UserError: a flow without controls, or times or controls that are invalid.
    """
    if isinstance(flow, Wrapped):
        return flow._replace(flow=steered(flow.flow, times, controls, linear=linear))
    moments, given = as_float64(times, "times"), as_float64(controls, "controls")
    size = clock_of(flow) - 1
    shape = (len(moments) if moments.ndim == 1 else -1, size)
    finite = bool(moments.isfinite().all() & given.isfinite().all())
    known = finite and moments.ndim == 1 and bool((moments.diff() > 0).all())
    if size < 1 or given.ndim not in (2, 3) or given.shape[-2:] != shape or not known:
        expected = (
            f"finite, increasing times (T,) and controls (T, {size})" if size > 0 else "a flow with controls"
        )
        message = f"steered: expected {expected}; received {tuple(moments.shape)} and {tuple(given.shape)}"
        raise UserError(message)
    return Steered(flow, ControlTable(moments, given, linear))


class Wrapped(NamedTuple):
    """Time-dependent flow with a wrapper.

    Attributes:
        flow: time-dependent flow.
        wrap: function applied to the flow once it is bound to a time.
    """

    flow: Flow
    wrap: Callable[[Flow], Flow]

    @property
    def clock(self) -> int:
        """Number of clock coordinates of the wrapped flow."""
        return clock_of(self.flow)

    def at(self, time: float | Tensor) -> Flow:
        """Bind the flow to a start time."""
        return self.wrap(at(self.flow, time))

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Raise UserError: the start time is unknown."""
        raise UserError(NO_TIME)


def wrapped(flow: Flow, wrap: Callable[[Flow], Flow]) -> Flow:
    """Apply a wrapper to a flow, directly or, for time-dependent flows, once it is bound to a time."""
    return Wrapped(flow, wrap) if clock_of(flow) else wrap(flow)
