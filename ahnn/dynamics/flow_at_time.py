"""A flow that depends on time, from an instant on: a map of plain states, as estimators take it."""

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
    """Return a flow from an instant on; one that does not depend on time comes back as it is.

    Args:
        flow: any flow.
        time: of the instant, or (B,) of one for each of B members.

    Raises:
        UserError: a flow with controls, which no clock tells.
    """
    if not clock_of(flow):
        return flow
    own = getattr(flow, "at", None)
    return own(time) if own is not None else Bound(flow, _instant(time))


def _instant(time: float | Tensor) -> float | Tensor:
    """Return one time as a number, times of members as they are."""
    return time if isinstance(time, Tensor) and time.ndim else float(time)


class Bound(NamedTuple):
    """A flow of extended states, begun at one time with states of 2n components.

    Attributes:
        flow: which depends on time.
        time: at which its steps begin, or (B,) of each member.
        controls: values and rates there, (m,) each, or (B, m); None where it depends on time alone.
    """

    flow: Flow
    time: float | Tensor
    controls: tuple[Tensor, Tensor] | None = None

    def clock(self, x: Tensor) -> Clock:
        """Return the clock of states (B, 2n); raises UserError for controls that are not known."""
        if clock_of(self.flow) > 1 and self.controls is None:
            message = (
                "flow: expected forces of state and time in an estimator; received some of controls. "
                "`ahnn.dynamics.flow_at_time.steered` makes them known"
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
    """Return controls (m,) or (B, m) for `count` states, so many in a row for each of B members.

    Raises:
        UserError: states of another number of members.
    """
    if values.ndim == 1:
        return values.expand(count, -1)
    if count % len(values):
        message = f"steered: expected states of {len(values)} members, as controls have; received {count}"
        raise UserError(message)
    return values.repeat_interleave(count // len(values), dim=0)


class Steered(NamedTuple):
    """A flow whose controls are known over time: it depends on time alone.

    Attributes:
        flow: with m controls.
        controls: of all members, or of each.
    """

    flow: Flow
    controls: ControlTable

    @property
    def clock(self) -> int:
        """1, time."""
        return 1

    def at(self, time: float | Tensor) -> Flow:
        """Return the flow from an instant on; before the first sample and after the last these are held."""
        times = self.controls.times
        near = NEAR * float(times[-1] - times[0])
        values, rates = self.controls.begun(times.new_tensor([float(time)]), near)
        return Bound(self.flow, float(time), (values[..., 0, :], rates[..., 0, :]))

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states after dt, of a flow that was not told when; raises UserError."""
        del x, dt
        raise UserError(NO_TIME)


def steered(flow: Flow, times: Numbers, controls: Numbers, *, linear: bool = False) -> Flow:
    """Return a flow with controls that are known over time, as filters, smoothers and least squares take it.

    Args:
        flow: of learned or known dynamics with m controls, or what `wrapped` made of one.
        times: (T,) increasing.
        controls: (T, m), or (B, T, m) for B members; each held until the next sample.
        linear: whether they are interpolated linearly instead.

    A step must not go beyond the next sample of a held control.

    Raises:
        UserError: a flow without controls, numbers of another shape, or some that are not finite.
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
            f"finite times (T,) that increase and controls (T, {size})"
            if size > 0
            else "a flow with controls"
        )
        message = f"steered: expected {expected}; received {tuple(moments.shape)} and {tuple(given.shape)}"
        raise UserError(message)
    return Steered(flow, ControlTable(moments, given, linear))


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
        raise UserError(NO_TIME)


def wrapped(flow: Flow, wrap: Callable[[Flow], Flow]) -> Flow:
    """Return what is made of a flow, whether it depends on time or not."""
    return Wrapped(flow, wrap) if clock_of(flow) else wrap(flow)
