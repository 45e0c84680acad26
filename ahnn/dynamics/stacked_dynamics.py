"""Members of an ensemble as one map: states grouped by member, propagated together.

Each member is a separate module; all share architecture and scalings. A step of all members is a single
operation: in C with one member per core, otherwise by `torch.func.vmap` over their stacked parameters, with
one kernel for all members.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.func import functional_call, vmap

from ahnn.dynamics.base import Dynamics
from ahnn.dynamics.fields import HamiltonianDynamics
from ahnn.dynamics.gradients import Layers
from ahnn.dynamics.parallel_steps import can_run, parallel_steps
from ahnn.dynamics.recorded_flow import is_fixed
from ahnn.types import TimeStep


class StackedDynamics:
    """Increments of E members for states (E B, D), the first B of which belong to the first member.

    Args:
        members: dynamics of one architecture, with equal buffers; their parameters receive the gradients, and
            must not change while this object is in use.
    """

    def __init__(self, members: Sequence[Dynamics]) -> None:
        self.members = list(members)
        self.clock = self.members[0].clock
        self._layers: list[Layers] = []
        self._vectorised = is_fixed(self.members[0])

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states (E B, D) after dt, a number or (E B,)."""
        return x + self.increment(x, dt)

    def increment(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the increments of states x, shape (E B, D), over dt, a number or (E B,)."""
        if (found := self._in_c(x, dt)) is not None:
            return found
        return self._mapped("increment", x, dt)

    def field(self, x: Tensor) -> Tensor:
        """Return dx/dt at the states x, both of shape (E B, D), for dynamics with a vector field."""
        return self._mapped("field", x)

    def _in_c(self, x: Tensor, dt: TimeStep) -> Tensor | None:
        """Return the increments if all members take steps in C, else None."""
        if not all(isinstance(member, HamiltonianDynamics) for member in self.members):
            return None
        known, count = cast("list[HamiltonianDynamics]", self.members), len(self.members)
        if not self._layers:
            self._layers = [found for one in known if (found := one.fused_layers(x)) is not None]
        if len(self._layers) < count:
            return None
        steps = dt.chunk(count) if isinstance(dt, Tensor) and dt.ndim else (dt,) * count
        starts, schemes = x.chunk(count), [one.scheme(step) for one, step in zip(known, steps, strict=True)]
        if not can_run(starts, self._layers, schemes):
            return None
        return parallel_steps(starts, self._layers, schemes)

    def _mapped(self, name: str, x: Tensor, *dt: TimeStep) -> Tensor:
        """Evaluate a method of all members at their states, by vmap unless its operations depend on data."""
        count = len(self.members)
        rows, steps = x.unflatten(0, (count, -1)), [_grouped(step, count) for step in dt]
        along = [0 if isinstance(step, Tensor) and step.ndim else None for step in steps]
        if not self._vectorised:
            found = []
            for k, (member, own) in enumerate(zip(self.members, rows.unbind(), strict=True)):
                parts = [
                    step if axis is None else cast(Tensor, step)[k]
                    for step, axis in zip(steps, along, strict=True)
                ]
                found.append(getattr(member, name)(own, *parts))
            return torch.cat(found)
        first = _Method(self.members[0], name)
        held = dict(first.named_buffers())
        known = [dict(member.named_parameters(prefix="module")) for member in self.members]
        stacked = {key: torch.stack([one[key] for one in known]) for key in known[0]}

        def call(parameters: dict[str, Tensor], own: Tensor, *rest: Any) -> Tensor:
            return functional_call(first, {**parameters, **held}, (own, *rest))

        return vmap(call, (0, 0, *along))(stacked, rows, *steps).flatten(0, 1)


class _Method(nn.Module):
    """Wrapper whose forward pass is a method of a module, for `functional_call`."""

    def __init__(self, module: nn.Module, name: str) -> None:
        super().__init__()
        self.module, self.name = module, name

    def forward(self, *given: Any) -> Tensor:
        return getattr(self.module, self.name)(*given)


def _grouped(step: TimeStep, count: int) -> TimeStep:
    """Return steps (E B,) as (E, B); a single number is returned unchanged."""
    return step.unflatten(0, (count, -1)) if isinstance(step, Tensor) and step.ndim else step
