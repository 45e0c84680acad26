"""Parameters and weights of sigma points, and interfaces of covariance forms."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.results import Predicted, Updated


class UnscentedParameters(NamedTuple):
    """Parameters of the scaled unscented transformation (Wan & van der Merwe 2000).

    Each parameter is a number, or a (B,) tensor with one value per member. The defaults give no negative
    weight; beta = 2 is optimal for Gaussian beliefs.
    """

    alpha: float | Tensor = 1.0
    beta: float | Tensor = 2.0
    kappa: float | Tensor = 0.0


class SigmaWeights(NamedTuple):
    """Weights of 2 D + 1 sigma points; tensors are float64 of shape (B or 1, 1, 1).

    `recentring` and `downdate` rewrite the textbook covariance without its centre weight, which is negative
    for small alpha. With deviations e_i from the image of the centre, and shift = outer * sum_i e_i,

        sum_i Wc_i (Y_i - mean)(Y_i - mean)ᵀ
            = outer * sum_{i>0} (e_i - recentring * shift)(...)ᵀ - downdate * shift shiftᵀ

    holds exactly, without any subtraction if alpha² kappa + D beta >= 0.

    Attributes:
        radius: sqrt(D + lambda), distance of the points, in standard deviations.
        outer: weight W_i of all points except the centre, for mean and covariance.
        mean_centre: W_m0.
        covariance_centre: W_c0.
        recentring: fraction of the shift subtracted from the deviations.
        downdate: factor of the remaining subtraction; None if zero for all members.
        crowding: D / radius², the factor by which the mean amplifies rounding errors, for members with
            closely spaced points and 0 for all other members; None if negligible for every member.
    """

    radius: Tensor
    outer: Tensor
    mean_centre: Tensor
    covariance_centre: Tensor
    recentring: Tensor
    downdate: Tensor | None
    crowding: Tensor | None


Residual = Callable[[Tensor, Tensor], Tensor]
"""Difference y - y_pred of two measurements, shape (..., M), with angles wrapped."""
Predict = Callable[[Tensor, SigmaWeights, Tensor], Predicted]
"""Propagated sigma points (B, S, D), weights and chol_q -> belief, with additive process noise."""
Update = Callable[[Belief, Tensor, Tensor, Residual, SigmaWeights, Tensor], Updated]
"""Prior, its measured sigma points (B, S, M), row y (B, M), residual, weights and chol_r -> posterior.

Missing components of y are NaN.
"""
Read = Callable[[Belief, Tensor, SigmaWeights, Tensor], Updated | None]
"""Prior, row y (B, M) of the first M state components, weights and chol_r -> posterior, without sigma points.

None if sigma points are required.
"""


class Form(NamedTuple):
    """Form of the covariance: the functions called by the time loop.

    Attributes:
        name: name for messages.
        predict: see `Predict`.
        update: see `Update`.
        squares: whether covariances are formed, which loses digits and requires definite measurement noise.
        read: see `Read`; or None.
    """

    name: str
    predict: Predict
    update: Update
    squares: bool
    read: Read | None = None
