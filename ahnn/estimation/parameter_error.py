"""Learned parameters as filter states, with their prior covariance, updated by measurements.

The field is f(x) + C(x) eta, with unknown constant coordinates eta along uncertain directions of the
parameters, a priori N(0, I). A step applies half the increment of C(x) eta, the flow, and the other half
(Strang splitting). The parameters have no process noise: errors of a learned force recur on every orbit, and
measurements determine them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, cast

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector

from ahnn.dynamics import Dynamics, HasField
from ahnn.dynamics.derivatives import field_jacobian
from ahnn.dynamics.flow_at_time import wrapped
from ahnn.estimation.belief import Belief
from ahnn.measurements import DerivedMeasurement, Measurement
from ahnn.types import Flow, TimeStep


class ParameterError(NamedTuple):
    """Parameter directions as filter states; augmented states are (x, eta), shape (..., D + K).

    Attributes:
        columns: x (..., D) -> C(x), (..., D, K).
        added: number K of directions.
        size: standard deviation of each component of eta, a number or (B,).
        left_out: upper bound on the contribution of omitted directions to the NEES of a filter.
        name: identifier of the directions, which must match a saved filter.
    """

    columns: Callable[[Tensor], Tensor]
    added: int
    size: Tensor | float = 1.0
    left_out: float = 0.0
    name: str = ""

    @property
    def about(self) -> list[float | str]:
        """Plain values that identify the error model for given weights."""
        return [float(self.added), float(self.size), self.name]

    def numbers(self, states: Tensor) -> Tensor:
        """Return numbers that identify the error model, with columns at the first of states (B, T, D)."""
        return torch.cat(
            (
                torch.tensor([float(self.added), float(self.size)]),
                self.columns(states[:1, 0]).flatten().float(),
            )
        )

    def belief(self, belief: Belief) -> Belief:
        """Return the augmented belief, with parameters that are independent of the state."""
        mean, chol = belief
        (batch, size), count = mean.shape, self.added
        own = torch.as_tensor(self.size, dtype=mean.dtype, device=mean.device).expand(batch)
        both = chol.new_zeros(batch, size + count, size + count)
        both[:, :size, :size] = chol
        both[:, size:, size:] = own[:, None, None] * torch.eye(count, dtype=mean.dtype, device=mean.device)
        return Belief(torch.nn.functional.pad(mean, (0, count)), both)

    def flow(self, flow: Flow) -> Flow:
        """Return the flow of augmented states."""
        return wrapped(flow, self._augmented)

    def _augmented(self, flow: Flow) -> Flow:
        def augmented(x: Tensor, dt: TimeStep) -> Tensor:
            state, eta = x[..., : -self.added], x[..., -self.added :]
            half = 0.5 * (dt.unsqueeze(-1) if isinstance(dt, Tensor) else dt)

            def pushed(x: Tensor) -> Tensor:
                return x + half * (self.columns(x) @ eta.unsqueeze(-1)).squeeze(-1)

            return torch.cat((pushed(flow(pushed(state), dt)), eta), dim=-1)

        return augmented

    def process_noise(self, additive: Tensor, dt: float) -> Tensor:
        """Return Q of augmented states for one step; the parameters are constant."""
        return torch.nn.functional.pad(additive, (0, self.added, 0, self.added))

    def measurement(self, measurement: Measurement) -> Measurement:
        """Return a measurement model of augmented states that uses their first D components."""
        return DerivedMeasurement(measurement, lambda x, t: measurement(x[..., : -self.added], t))


def field_columns(dynamics: Dynamics, directions: Tensor) -> Callable[[Tensor], Tensor]:
    """Return x (..., D) -> (..., D, K), derivatives of the field along parameter directions (P, K)."""
    theta = parameters_to_vector(dynamics.parameters()).detach()
    forcing, along = field_jacobian(cast(HasField, dynamics)), directions.float()

    @torch.no_grad()
    def columns(x: Tensor) -> Tensor:
        learned = (forcing(theta, x) @ along).to(x)
        known = learned.new_zeros(*x.shape[:-1], x.shape[-1] - learned.shape[-2], learned.shape[-1])
        return torch.cat((known, learned), dim=-2)

    return columns
