"""A step of any flow together with its state transition dx(t + dt)/dx(t)."""

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
    """Return the states (B, D) after a step from x, one or (B,), and the transitions (B, D, D).

    A flow that has a method `transition(x, dt)` is asked; exact flows take differences, good to 1e-8.
    Learned Hamiltonians move variations beside the states, in closed form; any other flow is
    differentiated by reverse mode.
    """
    own = getattr(flow, "transition", None)
    if own is not None:
        return own(x, dt)
    if not torch.is_grad_enabled() and isinstance(flow, HamiltonianDynamics):
        field, method = varied(flow.field), flow.integrator
        if field is not None and isinstance(method, ExplicitRungeKutta | SymmetricComposition):
            step = column(dt)  # of a member and of its variations
            return moved(lambda z: z + method.increment(cast(Any, field), z, step), x)
    with torch.inference_mode(mode=False):
        x = x.clone() if x.is_inference() else x
        return flow(x, dt), pointwise_jacobian(lambda z: flow(z, dt).to(z.dtype), x)
