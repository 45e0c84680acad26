"""Weights and sigma points of the scaled unscented transformation (Wan & van der Merwe 2000)."""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.errors import UserError
from ahnn.estimation.belief import Belief
from ahnn.numbers import as_float64
from ahnn_plugins.ukf import members
from ahnn_plugins.ukf.parameters import SigmaWeights, UnscentedParameters

CROWDED = 100.0
"""Amplification D / (D + lambda) of rounding errors above which it is monitored: alpha < 0.1 if kappa = 0."""


def unscented_weights(
    parameters: UnscentedParameters, size: int, device: torch.device | None = None, *, batch: int = 1
) -> SigmaWeights:
    """Return the weights for states of D components.

    lambda = alpha² (D + kappa) - D, W_m0 = lambda / (D + lambda), W_c0 = W_m0 + 1 - alpha² + beta and
    W_i = 1 / (2 (D + lambda)): Wan & van der Merwe 2000, eq. 15.

    Args:
        parameters: alpha, beta and kappa, each a number or a (B,) tensor.
        size: dimension D.
        device: device of the weights.
        batch: number of members B.

    Raises:
        UserError: a parameter is not finite or not of length 1 or B, or D + lambda = alpha² (D + kappa)
            is not positive.
    """
    alpha, beta, kappa = torch.broadcast_tensors(*_checked(parameters, device, batch))
    total = alpha**2 * (size + kappa)
    _check_total(total, alpha, kappa, size)
    mean_centre = (total - size) / total
    outer_sum = size / total
    crowded = outer_sum > CROWDED
    radicand = 1.0 + outer_sum * (beta - alpha**2)
    return SigmaWeights(
        radius=total.sqrt(),
        outer=0.5 / total,
        mean_centre=mean_centre,
        covariance_centre=mean_centre + 1.0 - alpha**2 + beta,
        recentring=(1.0 - radicand.clamp(min=0.0).sqrt()) / outer_sum,
        downdate=(-radicand).clamp(min=0.0) / outer_sum if bool((radicand < 0.0).any()) else None,
        crowding=torch.where(crowded, outer_sum, 0.0).detach() if bool(crowded.any()) else None,
    )


def _checked(parameters: UnscentedParameters, device: torch.device | None, batch: int) -> list[Tensor]:
    """Return finite alpha, beta and kappa, each (1, 1, 1) or (B, 1, 1) float64."""
    columns = []
    for name, value in zip(UnscentedParameters._fields, parameters, strict=True):
        column = as_float64(value, f"unscented_weights: {name}", device)
        if tuple(column.shape) not in {(), (1,), (batch,)} or not bool(column.isfinite().all()):
            message = (
                f"unscented_weights: expected {name} to be one finite number or one for each of {batch} "
                f"members; received {column.tolist()}"
            )
            raise UserError(message)
        columns.append(column.reshape(-1, 1, 1))
    return columns


def _check_total(total: Tensor, alpha: Tensor, kappa: Tensor, size: int) -> None:
    if not bool((total > 0.0).all()):
        b = int((~(total > 0.0)).flatten().nonzero()[0])
        received = (float(value.flatten()[b]) for value in (total, alpha, kappa))
        message = (
            "unscented_weights: expected L + lambda = alpha² (L + kappa) > 0; received "
            "{:g} with alpha = {:g}, kappa = {:g}, L = {}; choose alpha != 0 and kappa > -L"
        ).format(*received, size)
        raise UserError(message)


def draw(belief: Belief, weights: SigmaWeights) -> Tensor:
    """Return the sigma points (B, 2 D + 1, D): mean, mean + radius L_i, mean - radius L_i; L = chol."""
    if members.apply_to(weights, *belief):
        return members.draw(belief, weights)
    centre = belief.mean.unsqueeze(1)
    spread = weights.radius * belief.chol.mT
    return torch.cat((centre, centre + spread, centre - spread), dim=1)
