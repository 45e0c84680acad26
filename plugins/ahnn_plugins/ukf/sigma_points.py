"""Weights and points of the scaled unscented transformation (Wan & van der Merwe 2000)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn_plugins.ukf.types import Belief, UnscentedParameters


class Weights(NamedTuple):
    """Weights of 2 D + 1 sigma points; tensors are float64 of shape (B or 1, 1, 1).

    The last two fields rewrite the textbook covariance without its centre weight, which is negative for
    small alpha. With deviations e_i from the image of the centre, and shift = outer * sum_i e_i,

        sum_i Wc_i (Y_i - mean)(Y_i - mean)ᵀ
            = outer * sum_{i>0} (e_i - recentring * shift)(...)ᵀ - downdate * shift shiftᵀ

    exactly, and nothing is left to subtract whenever alpha² kappa + D beta >= 0.

    Attributes:
        radius: sqrt(D + lambda), distance of the points in standard deviations.
        outer: W_i of every point but the centre, mean and covariance alike.
        mean_centre: W_m0.
        covariance_centre: W_c0.
        recentring: share of the shift that the deviations lose.
        downdate: what is left to subtract; None if nothing is, for any member.
    """

    radius: Tensor
    outer: Tensor
    mean_centre: Tensor
    covariance_centre: Tensor
    recentring: Tensor
    downdate: Tensor | None


def unscented_weights(
    parameters: UnscentedParameters, size: int, device: torch.device | None = None
) -> Weights:
    """Return the weights for states of D components.

    lambda = alpha² (D + kappa) - D, W_m0 = lambda / (D + lambda), W_c0 = W_m0 + 1 - alpha² + beta and
    W_i = 1 / (2 (D + lambda)): Wan & van der Merwe 2000, eq. 15.

    Args:
        parameters: alpha, beta and kappa, each a number or a (B,) tensor.
        size: D.
        device: of the weights.

    Raises:
        ValueError: if D + lambda = alpha² (D + kappa) is not positive.
    """
    alpha, beta, kappa = torch.broadcast_tensors(
        *(torch.as_tensor(p, dtype=torch.float64, device=device).reshape(-1, 1, 1) for p in parameters)
    )
    total = alpha**2 * (size + kappa)
    if not bool((total > 0.0).all()):
        b = int((~(total > 0.0)).flatten().nonzero()[0])
        received = (float(value.flatten()[b]) for value in (total, alpha, kappa))
        message = (
            "unscented_weights: expected L + lambda = alpha² (L + kappa) > 0, got "
            "{:g} with alpha = {:g}, kappa = {:g}, L = {}; choose alpha != 0 and kappa > -L"
        ).format(*received, size)
        raise ValueError(message)
    mean_centre = (total - size) / total
    outer_sum = size / total
    radicand = 1.0 + outer_sum * (beta - alpha**2)
    return Weights(
        radius=total.sqrt(),
        outer=0.5 / total,
        mean_centre=mean_centre,
        covariance_centre=mean_centre + 1.0 - alpha**2 + beta,
        recentring=(1.0 - radicand.clamp(min=0.0).sqrt()) / outer_sum,
        downdate=(-radicand).clamp(min=0.0) / outer_sum if bool((radicand < 0.0).any()) else None,
    )


def draw(belief: Belief, weights: Weights) -> Tensor:
    """Return the sigma points (B, 2 D + 1, D): the mean, then mean + radius L_i, then mean - radius L_i."""
    centre = belief.mean.unsqueeze(1)
    spread = weights.radius * belief.chol.mT
    return torch.cat((centre, centre + spread, centre - spread), dim=1)
