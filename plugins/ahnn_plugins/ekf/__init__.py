"""Extended Kalman filter: flow and measurements linearised at the mean, covariances as factors.

The Jacobian of a step is its state transition (`ahnn.dynamics.transition`), in closed form for learned
Hamiltonians; that of a measurement is by reverse mode (Bar-Shalom, Li & Kirubarajan 2001, section 10.3).
Prediction and update triangularise rows and subtract nothing (Kailath, Sayed & Hassibi 2000, chapter 12).
Gate, status, streams, process noise, figures and rows are those of every filter, see
`ahnn.estimation.estimator`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, final

import torch
from torch import Tensor
from torch.nn.functional import pad

from ahnn.dynamics.transition import transition
from ahnn.estimation.belief import Belief
from ahnn.estimation.conditioning import conditioned, present_noise
from ahnn.estimation.estimator import SensorModel
from ahnn.estimation.gate import Gate
from ahnn.estimation.gaussian import GaussianFilter
from ahnn.estimation.kernel import measured, require_states
from ahnn.estimation.linalg import tria
from ahnn.estimation.results import Predicted, Updated
from ahnn.estimation.rounding import Rounding
from ahnn.estimation.smoother import backward_law
from ahnn.jacobians import pointwise_jacobian
from ahnn.measurements import residual
from ahnn.types import Flow

__all__ = ["ExtendedKalmanFilter", "LinearisedKernel"]


class LinearisedKernel(NamedTuple):
    """Predictions and updates to first order about the mean."""

    @property
    def rounding(self) -> Rounding:
        """Nothing is amplified: means are images of means, and covariances are never formed."""
        return Rounding()

    def predict(
        self, belief: Belief, flow: Flow, dt: float, chol_q: Tensor, *, smoothing: bool = False
    ) -> Predicted:
        """Return the image of the mean, and the covariance that the state transition carries, plus Q."""
        mean, moved = transition(flow, belief.mean, dt)
        require_states(mean, belief.mean.shape)
        spread, size = (moved.to(belief.chol) @ belief.chol).mT, belief.mean.shape[-1]
        if not smoothing:
            return Predicted(Belief(mean.to(belief.mean), tria(torch.cat((spread, chol_q.mT), dim=1))))
        after = torch.cat((spread, chol_q.mT), dim=1)
        joint = tria(torch.cat((after, pad(belief.chol.mT, (0, 0, 0, size))), dim=-1))
        law, singular = backward_law(joint)
        return Predicted(Belief(mean.to(belief.mean), joint[:, :size, :size]), None, False, law, singular)

    def update(self, prior: Belief, y: Tensor, sensor: SensorModel, time: float) -> Updated:
        """Return the belief given the components of y that are not NaN."""
        model, present = sensor.measurement, ~torch.isnan(y)
        predicted = measured(model, prior.mean.unsqueeze(1), time)[:, 0]
        with torch.inference_mode(mode=False):
            at = prior.mean.clone() if prior.mean.is_inference() else prior.mean
            slope = pointwise_jacobian(lambda x: model(x, time).to(x.dtype), at)
        # What is missing is filled in: a residual may mix components.
        innovation = residual(model, torch.where(present, y, predicted), predicted)
        innovation = torch.where(present, innovation, 0.0)
        image = torch.where(present.unsqueeze(1), (slope @ prior.chol).mT, 0.0)
        image = torch.cat((image, present_noise(sensor.chol_r, present)), dim=1)
        state = pad(prior.chol.mT, (0, 0, 0, image.shape[1] - prior.chol.shape[1]))
        return conditioned(prior, tria(torch.cat((image, state), dim=-1)), innovation, y)


@final
@dataclass(frozen=True)
class ExtendedKalmanFilter(GaussianFilter):
    """Extended Kalman filter with additive noise for a batch of B members, see `GaussianFilter`.

    A flow or a measurement model must be differentiable by torch.

    Attributes:
        gate: refuses improbable measurement rows; None takes all.
    """

    gate: Gate | None = None

    @property
    def name(self) -> str:
        """What its rows are called."""
        return "ekf"

    def kernel(self, belief: Belief) -> LinearisedKernel:
        """Return the linearisation, which has no constants."""
        del belief
        return LinearisedKernel()
