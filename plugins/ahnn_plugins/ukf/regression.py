"""Statistical linear regression of a flow and of a measurement over Gaussian beliefs, by sigma points.

For x ~ N(mean, P), a function f is replaced by A x + b + noise of covariance Omega. Here A = C P⁻¹ with the
covariance C of f(x) and x, while b and Omega preserve the mean and covariance of f(x) (Arasaratnam, Haykin &
Elliott 2007). Sums and differences of opposite points make covariances unnecessary: the differences are the
factor of P times Aᵀ, and the sums, even in the deviation, give the residual covariance.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.errors import UserError
from ahnn.estimation.belief import Belief
from ahnn.estimation.estimator import SensorModel
from ahnn.estimation.linalg import tria
from ahnn.measurements import DerivedMeasurement, residual
from ahnn.types import Flow, TimeStep
from ahnn_plugins.ukf.parameters import SigmaWeights, UnscentedParameters
from ahnn_plugins.ukf.sigma_points import draw, unscented_weights


class AffineModel(NamedTuple):
    """f(x) = slope x + offset + noise.

    Attributes:
        slope: (B, N, D) matrix A.
        offset: (B, N) vector b.
        rest: (B, D, N) rows; the noise covariance is restᵀ rest.
    """

    slope: Tensor
    offset: Tensor
    rest: Tensor

    def __call__(self, x: Tensor) -> Tensor:
        """Evaluate the affine model at x, shape (B, S, D); return (B, S, N)."""
        return x @ self.slope.mT + self.offset.unsqueeze(1)


def regression_weights(
    parameters: UnscentedParameters, size: int, device: torch.device | None = None
) -> SigmaWeights:
    """Return the weights of the sigma points for states of D components.

    Raises:
        UserError: no sigma points, or negative weights, for which Omega could be indefinite.
    """
    weights = unscented_weights(parameters, size, device)
    if weights.downdate is not None:
        message = (
            "iterated smoother: expected alpha² kappa + D beta >= 0, which leaves no negative weight; "
            f"received {parameters} with D = {size}"
        )
        raise UserError(message)
    return weights


def regression(belief: Belief, centre: Tensor, outer: Tensor, weights: SigmaWeights) -> AffineModel:
    """Return the regression of a function over a belief.

    Args:
        belief: belief of dimension D.
        centre: (B, N) image of the mean.
        outer: (B, 2 D, N) images of the other sigma points minus the image of the mean.
        weights: non-negative sigma point weights.
    """
    shift = weights.outer * outer.sum(1, keepdim=True)
    deviations = (outer - weights.recentring * shift) * (0.5 * weights.outer).sqrt()
    plus, minus = deviations.chunk(2, dim=1)
    slope = torch.linalg.solve_triangular(belief.chol, (plus - minus).mT, upper=False, left=False)
    offset = centre + shift[:, 0] - (slope @ belief.mean.unsqueeze(-1)).squeeze(-1)
    return AffineModel(slope, offset, plus + minus)


def linear_flow(
    flow: Flow, dt: float, belief: Belief, weights: SigmaWeights, chol_q: Tensor
) -> tuple[Flow, Tensor]:
    """Return the regression of a flow step, and the factor (B, D, D) of its noise covariance plus Q."""
    points = draw(belief, weights)
    images = flow(points.flatten(0, 1), dt).to(points.dtype).reshape(points.shape)
    affine = regression(belief, images[:, 0], images[:, 1:] - images[:, :1], weights)

    def line(x: Tensor, dt: TimeStep) -> Tensor:  # noqa: ARG001 - specific to this step
        return affine(x.unflatten(0, (len(belief.mean), -1))).flatten(0, 1)

    return line, tria(torch.cat((affine.rest, chol_q.mT), dim=1))


def linear_sensor(sensor: SensorModel, t: float, belief: Belief, weights: SigmaWeights) -> SensorModel:
    """Return a sensor with the regression of its model at time t, and the regression noise added to R."""
    images = sensor.measurement(draw(belief, weights), t)
    outer = residual(sensor.measurement, images[:, 1:], images[:, :1])
    affine = regression(belief, images[:, 0], outer, weights)
    chol_r = tria(torch.cat((affine.rest, sensor.chol_r.mT), dim=1))
    line = DerivedMeasurement(sensor.measurement, lambda x, _t: affine(x))
    return sensor._replace(measurement=line, chol_r=chol_r)
