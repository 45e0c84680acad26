"""State transition dx(t + dt)/dx(t) of a step of any flow."""

from __future__ import annotations

from typing import Any, cast

import torch
from torch import Tensor

from ahnn.dynamics.fields import HamiltonianDynamics
from ahnn.dynamics.variations import varied
from ahnn.integrators import ExplicitRungeKutta, SymmetricComposition, column
from ahnn.jacobians import moved, pointwise_jacobian
from ahnn.types import Flow, TimeStep


def transition(flow: Flow, x: Tensor, dt: TimeStep) -> tuple[Tensor, Tensor]:
    """Return the states (B, D) after a step dt, one or (B,), from x, and the transitions (B, D, D).

    Uses the flow's method `transition(x, dt)` where it exists. Exact flows use finite differences, accurate
    to 1e-8; learned Hamiltonians propagate variations with the states, in closed form; other flows are
    differentiated by reverse mode.
    """
    own = getattr(flow, "transition", None)
    if own is not None:
        return own(x, dt)
    if not torch.is_grad_enabled() and isinstance(flow, HamiltonianDynamics):
        field, method = varied(flow.field), flow.integrator
        if field is not None and isinstance(method, ExplicitRungeKutta | SymmetricComposition):
            step = column(dt)  # a member and its derivatives share one step
            return moved(lambda z: z + method.increment(cast(Any, field), z, step), x)
    with torch.inference_mode(mode=False):
        x = x.clone() if x.is_inference() else x
        return flow(x, dt), pointwise_jacobian(lambda z: flow(z, dt).to(z.dtype), x)
