"""An extended Kalman filter: the three functions of `ahnn.estimation.RecursiveEstimator`."""

import math
from collections.abc import Callable
from typing import NamedTuple, final

import torch
from torch import Tensor
from torch.func import jacrev, vmap

from ahnn.estimation import Belief, Innovation
from ahnn.measurements import Measurement, residual
from ahnn.types import Flow


class Estimate(NamedTuple):
    """What the filter carries: a belief about B members, and the time at which it holds."""

    belief: Belief
    time: Tensor


@final
class ExtendedKalmanFilter:
    """First-order propagation of mean and covariance; whatever is NaN in y was not measured."""

    def start(self, belief: Belief, time: float = 0.0) -> Estimate:
        """Return the state of a belief."""
        return Estimate(belief, torch.tensor(time, dtype=torch.float64))

    def predict(self, state: Estimate, flow: Flow, dt: float, process_noise: Tensor) -> Estimate:
        """Return the state after a step; process_noise is Q, (D, D)."""
        mean, f = linearised(lambda x: flow(x, dt), state.belief.mean)
        covariance = f @ state.belief.covariance @ f.mT + process_noise
        return Estimate(Belief(mean, torch.linalg.cholesky(covariance)), state.time + dt)

    def update(
        self, state: Estimate, y: Tensor, measurement: Measurement, measurement_noise: Tensor
    ) -> tuple[Estimate, Innovation]:
        """Return the state given y, (B, M), and what it told; measurement_noise is R, (M, M)."""
        mean, covariance = state.belief.mean, state.belief.covariance
        predicted, h = linearised(lambda x: measurement(x, state.time), mean)
        present = ~y.isnan()
        off = residual(measurement, y, predicted)
        error = torch.where(present, off, 0.0).unsqueeze(-1)
        h = torch.where(present.unsqueeze(-1), h, 0.0)
        both = present.unsqueeze(-1) & present.unsqueeze(-2)
        noise = torch.where(both, measurement_noise, torch.eye(y.shape[-1], dtype=y.dtype))
        s = h @ covariance @ h.mT + noise
        gain = torch.linalg.solve(s, h @ covariance).mT
        keep = torch.eye(mean.shape[-1], dtype=mean.dtype) - gain @ h
        after = keep @ covariance @ keep.mT + gain @ torch.where(both, measurement_noise, 0.0) @ gain.mT
        nis = (error.mT @ torch.linalg.solve(s, error)).flatten()
        measured = present.sum(-1)
        density = -0.5 * (nis + torch.logdet(s) + measured.to(nis) * math.log(2 * math.pi))
        belief = Belief(mean + (gain @ error).squeeze(-1), torch.linalg.cholesky(after))
        deviation = s.diagonal(dim1=-2, dim2=-1).sqrt().where(present, torch.nan)
        nis = nis.masked_fill(measured == 0, torch.nan)
        told = Innovation(off, deviation, nis, measured, measured < 0, density)
        return state._replace(belief=belief), told


def linearised(function: Callable[[Tensor], Tensor], x: Tensor) -> tuple[Tensor, Tensor]:
    """Return the values (B, K) of a function at x, (B, D), and its derivatives (B, K, D)."""
    return function(x), vmap(jacrev(lambda row: function(row.unsqueeze(0)).squeeze(0)))(x)
