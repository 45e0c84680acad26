"""Gauss-Hermite Kalman filter: a sigma-point filter with moments from a product of quadrature rules.

A rule of p nodes integrates polynomials up to degree 2 p - 1 in each component exactly (Ito & Xiong 2000;
Arasaratnam, Haykin & Elliott 2007), while unscented points are exact up to degree three. The product requires
p^D points, all of positive weight, so that factors are triangularised without subtraction. With three nodes
and one component the points agree with those of the unscented filter with kappa = 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple, final

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import pad

from ahnn.errors import UserError
from ahnn.estimation.belief import Belief
from ahnn.estimation.conditioning import conditioned, present_noise
from ahnn.estimation.estimator import SensorModel
from ahnn.estimation.gate import Gate
from ahnn.estimation.gaussian import GaussianFilter
from ahnn.estimation.kernel import measured, propagate
from ahnn.estimation.linalg import tria
from ahnn.estimation.results import Predicted, Updated
from ahnn.estimation.rounding import Rounding
from ahnn.estimation.sample_filter import image_deviations
from ahnn.estimation.smoother import backward_law
from ahnn.types import Flow

MOST = 20_000
"""Maximum number of points per member, enough for 3 nodes with 9 components or 5 nodes with 6."""


class HermiteRule(NamedTuple):
    """Product of Gauss-Hermite rules for N(0, I), with predictions and updates based on it.

    Attributes:
        nodes: (S, D) nodes, the node with the largest weight first.
        weights: (S, 1) positive weights with sum 1.
    """

    nodes: Tensor
    weights: Tensor

    @property
    def rounding(self) -> Rounding:
        """No amplification of rounding errors: weights are positive, and covariances are never formed."""
        return Rounding()

    def points(self, belief: Belief) -> Tensor:
        """Return the points (B, S, D) of beliefs."""
        return belief.mean.unsqueeze(1) + self.nodes @ belief.chol.mT

    def predict(
        self, belief: Belief, flow: Flow, dt: float, chol_q: Tensor, *, smoothing: bool = False
    ) -> Predicted:
        """Return the moments of the images of the points, plus Q; the flow is called once."""
        images, size = propagate(flow, self.points(belief), dt), belief.mean.shape[-1]
        outer = images - images[:, :1]
        shift = (self.weights * outer).sum(1)
        mean, after = images[:, 0] + shift, self.weights.sqrt() * (outer - shift.unsqueeze(1))
        if not smoothing:
            return Predicted(Belief(mean, tria(torch.cat((after, chol_q.mT), dim=1))))
        before = self.weights.sqrt() * (self.nodes @ belief.chol.mT)
        rows = torch.cat((torch.cat((after, before), -1), pad(chol_q.mT, (0, size))), dim=1)
        joint = tria(rows)
        law, singular = backward_law(joint)
        return Predicted(Belief(mean, joint[:, :size, :size]), None, False, law, singular)

    def update(self, prior: Belief, y: Tensor, sensor: SensorModel, time: float) -> Updated:
        """Return the belief given the components of y that are not NaN."""
        images = measured(sensor.measurement, self.points(prior), time)
        deviations, innovation = image_deviations(images, self.weights, y, sensor)
        state = self.nodes @ prior.chol.mT
        rows = self.weights.sqrt() * torch.cat((deviations, state), -1)
        noise = pad(present_noise(sensor.chol_r, ~torch.isnan(y)), (0, state.shape[-1]))
        return conditioned(prior, tria(torch.cat((rows, noise), dim=1)), innovation, y)


@cache
def hermite_rule(order: int, size: int, device: torch.device | None = None) -> HermiteRule:
    """Build the product of rules of `order` nodes for states of D components.

    Raises:
        UserError: more than `MOST` points.
    """
    if (count := order**size) > MOST:
        message = (
            f"order: expected at most {MOST:,} points; received {order} nodes for each of {size} components, "
            f"{count:.3g} points. Use fewer nodes, or plugins=ckf, which takes {2 * size}"
        )
        raise UserError(message)
    nodes, weights = np.polynomial.hermite_e.hermegauss(order)
    one, weight = torch.from_numpy(nodes), torch.from_numpy(weights / weights.sum())
    with torch.inference_mode(mode=False):  # cached, so it must also work with autograd
        places = torch.cartesian_prod(*[torch.arange(order)] * size).reshape(-1, size)
        weighed = weight[places].prod(-1)
        first = weighed.argsort(descending=True, stable=True)
        return HermiteRule(one[places][first].to(device), weighed[first].unsqueeze(-1).to(device))


@final
@dataclass(frozen=True)
class GaussHermiteFilter(GaussianFilter):
    """Gauss-Hermite Kalman filter with additive noise for a batch of B members, see `GaussianFilter`.

    Attributes:
        order: number of nodes per component, at least 2; there are order^D points.
        gate: gate for improbable measurement rows, or None.

    Raises:
        UserError: `order` is not an integer of at least 2.
    """

    order: int = 3
    gate: Gate | None = None

    def __post_init__(self) -> None:
        """Check the order and the gate."""
        super().__post_init__()
        if not isinstance(self.order, int) or self.order < 2:
            message = f"order: expected a whole number >= 2; received {self.order!r}"
            raise UserError(message)

    @property
    def name(self) -> str:
        """Name in tables."""
        return "ghkf"

    @property
    def about(self) -> dict[str, Any]:
        """Plain values that determine the estimates."""
        return {**super().about, "order": self.order}

    def kernel(self, belief: Belief) -> HermiteRule:
        """Return the rule for states of this size."""
        return hermite_rule(self.order, belief.mean.shape[-1], belief.mean.device)
