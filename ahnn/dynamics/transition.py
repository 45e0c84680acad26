"""A step of any flow together with its state transition dx(t + dt)/dx(t), as exact as the flow itself."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.dynamics.fields import HamiltonianDynamics
from ahnn.dynamics.variations import varied
from ahnn.integrators import ExplicitRungeKutta, SymmetricComposition
from ahnn.jacobians import pointwise_jacobian
from ahnn.types import Flow


def transition(flow: Flow, x: Tensor, dt: float) -> tuple[Tensor, Tensor]:
    """Return the states (B, D) after a step from x, and the transitions (B, D, D).

    A flow that has a method `transition(x, dt)` is asked. Learned Hamiltonians move variations beside the
    states, in closed form; any other flow is differentiated by reverse mode.
    """
    own = getattr(flow, "transition", None)
    if own is not None:
        return own(x, dt)
    if not torch.is_grad_enabled() and isinstance(flow, HamiltonianDynamics):
        field, method = varied(flow.field), flow.integrator
        if field is not None and isinstance(method, ExplicitRungeKutta | SymmetricComposition):
            beside = torch.eye(x.shape[1]).to(x).expand(len(x), -1, -1)
            moving = torch.cat((x.unsqueeze(1), beside), dim=1)
            after = moving + method.increment(field, moving, dt)
            return after[:, 0], after[:, 1:].mT
    with torch.inference_mode(mode=False):
        x = x.clone() if x.is_inference() else x
        return flow(x, dt), pointwise_jacobian(lambda z: flow(z, dt).to(z.dtype), x)
