"""Coloured, state-dependent process noise: a relative error of the flow's force.

A learned force has about the same relative error everywhere, with the same sign for some time. Each degree of
freedom therefore has an additional state, the relative force error e: a first-order Gauss-Markov process
(Tapley, Schutz & Born 2004, section 4.9), constant during a step:

    p' = F_p(x) + e |F_p(x) - p|,   q' = F_q(x) + dt / (2 m) e |F_p(x) - p|,   e' = exp(-dt / memory) e + w,

with w ~ N(0, size² (1 - exp(-2 dt / memory))), which keeps the variance of e at size². The impulse of the
step, F_p(x) - p, represents the force and exists for any flow. Like the force, the error is largest at
perigee, where constant process noise is too small, and it persists over many steps. Far from the training
data, or where the data do not determine the force, the learned force has larger errors; there, `growth`
multiplies e.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.dynamics.flow_at_time import wrapped
from ahnn.estimation.belief import Belief, leading
from ahnn.estimation.results import FilterResult, SmootherResult
from ahnn.measurements import DerivedMeasurement, Measurement
from ahnn.types import Flow, TimeStep


class ForceError(NamedTuple):
    """Relative force error with memory; augmented states are (q, p, e), shape (..., 3 n).

    Attributes:
        size: standard deviation of each component of e, a number or (B,).
        memory: time constant, in the unit of the flow.
        inertia: the factor m in p = m dq/dt.
        growth: function from states (..., 2 n) to factors (...) on the error; None for 1 everywhere.
    """

    size: Tensor | float
    memory: Tensor | float
    inertia: float | Tensor = 1.0
    growth: Callable[[Tensor], Tensor] | None = None

    @property
    def about(self) -> list[float]:
        """Plain numbers that identify the error model, except for its growth."""
        return [float(part) for part in self[:3]]

    def numbers(self, states: Tensor) -> Tensor:
        """Return numbers that identify the error model, with growth averaged over states (B, T, D)."""
        mean = 1.0 if self.growth is None else float(self.growth(states).mean())
        return torch.tensor([*self.about, mean])

    def belief(self, belief: Belief) -> Belief:
        """Return the augmented belief, with an independent error in its stationary distribution."""
        mean, chol = belief
        (batch, size), n = mean.shape, mean.shape[1] // 2
        sd = torch.as_tensor(self.size, dtype=mean.dtype, device=mean.device).expand(batch)
        error = sd[:, None, None] * torch.eye(n, dtype=mean.dtype, device=mean.device)
        upper = torch.cat((chol, chol.new_zeros(batch, size, n)), dim=-1)
        lower = torch.cat((chol.new_zeros(batch, n, size), error), dim=-1)
        return Belief(torch.nn.functional.pad(mean, (0, n)), torch.cat((upper, lower), dim=1))

    def flow(self, flow: Flow) -> Flow:
        """Return the flow of augmented states."""
        return wrapped(flow, self._augmented)

    def _augmented(self, flow: Flow) -> Flow:
        def augmented(x: Tensor, dt: TimeStep) -> Tensor:
            n = x.shape[-1] // 3
            state, error = x[..., : 2 * n], x[..., 2 * n :]
            after = flow(state, dt)
            kick = error * (after - state)[..., n:].norm(dim=-1, keepdim=True)
            if self.growth is not None:
                kick = kick * self.growth(state).unsqueeze(-1)
            step = dt.unsqueeze(-1) if isinstance(dt, Tensor) else dt
            moved = torch.cat((step / (2 * self.inertia) * kick, kick), dim=-1)
            return torch.cat((after + moved, self._kept(step) * error), dim=-1)

        return augmented

    def process_noise(self, additive: Tensor, dt: float) -> Tensor:
        """Return Q of augmented states for one step, (3 n, 3 n) or (B, 3 n, 3 n).

        Args:
            additive: covariance Q of the state itself, (2 n, 2 n) or (B, 2 n, 2 n).
            dt: length of the step.
        """
        dof = additive.shape[-1] // 2
        variance = torch.as_tensor(self.size, dtype=torch.float64) ** 2 * (1 - self._kept(dt) ** 2)
        error = torch.eye(dof, dtype=torch.float64) * variance[..., None, None]
        shape = torch.broadcast_shapes(additive.shape[:-2], error.shape[:-2])
        both = additive.new_zeros(*shape, 3 * dof, 3 * dof)
        both[..., : 2 * dof, : 2 * dof] = additive
        both[..., 2 * dof :, 2 * dof :] = error
        return both

    def measurement(self, measurement: Measurement) -> Measurement:
        """Return a measurement model of augmented states that uses their first 2 n components."""
        return DerivedMeasurement(measurement, lambda x, t: measurement(x[..., : x.shape[-1] // 3 * 2], t))

    def _kept(self, dt: TimeStep) -> Tensor:
        """Return the fraction of e that remains after a step."""
        return torch.exp(-torch.as_tensor(dt / self.memory, dtype=torch.float64))


def of_states(result: FilterResult, size: int) -> FilterResult:
    """Return the marginals of a filter result for the leading components of augmented states."""
    return result._replace(
        initial=leading(result.initial, size),
        means=result.means[..., :size],
        chols=result.chols[..., :size, :size],
        predicted_means=result.predicted_means[..., :size],
        predicted_chols=result.predicted_chols[..., :size, :size],
        backward=None,
        state=result.state.leading(size),
    )


def smoothed_states(result: SmootherResult, size: int) -> SmootherResult:
    """Return the marginals of a smoother result for the leading components of augmented states."""
    return result._replace(
        initial=leading(result.initial, size),
        means=result.means[..., :size],
        chols=result.chols[..., :size, :size],
    )
