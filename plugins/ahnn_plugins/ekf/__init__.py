"""Extended Kalman filter: flow and measurements linearised at the mean, covariances as factors.

The Jacobian of a step is its state transition (`ahnn.dynamics.transition`), in closed form for learned
Hamiltonians; the Jacobian of a measurement is computed by reverse mode (Bar-Shalom, Li & Kirubarajan 2001,
section 10.3). Prediction and update triangularise factors, without subtraction (Kailath, Sayed & Hassibi
2000, chapter 12). An iterated update relinearises the measurement at the latest mean: Gauss-Newton steps to
the most probable state (Bell & Cathey 1993). Innovation and likelihood refer to the prediction and are
unchanged by iterations. Gate, status, streams, process noise, figures and rows are common to all filters
(`ahnn.estimation.estimator`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, final

import torch
from torch import Tensor
from torch.nn.functional import pad

from ahnn.dynamics.transition import transition
from ahnn.errors import UserError
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
from ahnn.measurements import Sloped, residual
from ahnn.types import Flow

__all__ = ["ExtendedKalmanFilter", "LinearisedKernel"]


class LinearisedKernel(NamedTuple):
    """Predictions and updates to first order about the mean.

    Attributes:
        iterations: number of iterations of an update.
    """

    iterations: int = 1

    @property
    def rounding(self) -> Rounding:
        """No amplification of rounding errors: means are images of means; covariances are never formed."""
        return Rounding()

    def predict(
        self, belief: Belief, flow: Flow, dt: float, chol_q: Tensor, *, smoothing: bool = False
    ) -> Predicted:
        """Return the image of the mean, and the covariance propagated by the state transition, plus Q."""
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
        first = updated = self.linearised(prior, prior.mean, y, sensor, time)
        for _ in range(self.iterations - 1):
            updated = self.linearised(prior, updated.belief.mean, y, sensor, time)
        return first._replace(belief=updated.belief, singular=first.singular | updated.singular)

    def linearised(self, prior: Belief, at: Tensor, y: Tensor, sensor: SensorModel, time: float) -> Updated:
        """Condition the belief on y with the measurement linearised at the states `at`, (B, D)."""
        model, present = sensor.measurement, ~torch.isnan(y)
        with torch.inference_mode(mode=False):
            at = at.clone() if at.is_inference() else at
            if isinstance(model, Sloped):
                slope = model.slope(at, time)
            else:
                slope = pointwise_jacobian(lambda x: model(x, time).to(x.dtype), at)
        predicted = measured(model, at.unsqueeze(1), time)[:, 0]
        # Missing components are filled in, since a residual may mix components.
        innovation = residual(model, torch.where(present, y, predicted), predicted)
        innovation = innovation - (slope @ (prior.mean - at).unsqueeze(-1)).squeeze(-1)
        innovation = torch.where(present, innovation, 0.0)
        image = torch.where(present.unsqueeze(1), (slope @ prior.chol).mT, 0.0)
        image = torch.cat((image, present_noise(sensor.chol_r, present)), dim=1)
        state = pad(prior.chol.mT, (0, 0, 0, image.shape[1] - prior.chol.shape[1]))
        return conditioned(prior, tria(torch.cat((image, state), dim=-1)), innovation, y)


@final
@dataclass(frozen=True)
class ExtendedKalmanFilter(GaussianFilter):
    """Extended Kalman filter with additive noise for a batch of B members, see `GaussianFilter`.

    Flows and measurement models must be differentiable by torch or provide their derivatives (`transition`,
    `ahnn.measurements.Sloped`).

    Attributes:
        gate: gate for improbable measurement rows, or None.
        iterations: number of iterations of an update; 1 linearises at the prediction only.

    Raises:
        UserError: the number of iterations is not a positive integer.
    """

    gate: Gate | None = None
    iterations: int = 1

    def __post_init__(self) -> None:
        """Check the number of iterations and the gate."""
        super().__post_init__()
        if not isinstance(self.iterations, int) or self.iterations < 1:
            message = f"iterations: expected a whole number >= 1; received {self.iterations!r}"
            raise UserError(message)

    @property
    def about(self) -> dict[str, Any]:
        """Plain values that determine the estimates."""
        # States of streams saved before iterations were introduced imply one iteration.
        return super().about | ({} if self.iterations == 1 else {"iterations": self.iterations})

    @property
    def name(self) -> str:
        """Name in tables."""
        return "ekf"

    def kernel(self, belief: Belief) -> LinearisedKernel:
        """Return the linearised kernel."""
        return LinearisedKernel(self.iterations)
