"""What is of sigma points alone: their parameters, their weights, and the forms of the covariance."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.results import Predicted, Updated


class UnscentedParameters(NamedTuple):
    """Parameters of the scaled unscented transformation (Wan & van der Merwe 2000).

    Each is one number, or a (B,) tensor with one value per member. The defaults give no negative weight;
    beta = 2 is optimal for Gaussian beliefs.
    """

    alpha: float | Tensor = 1.0
    beta: float | Tensor = 2.0
    kappa: float | Tensor = 0.0


class SigmaWeights(NamedTuple):
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
        recentring: fraction of the shift that the deviations lose.
        downdate: what is left to subtract; None if nothing is, for any member.
        crowding: D / radius², by which the mean amplifies rounding, of members whose points lie so close that
            it matters, 0 of the others; None if it matters for no member.
    """

    radius: Tensor
    outer: Tensor
    mean_centre: Tensor
    covariance_centre: Tensor
    recentring: Tensor
    downdate: Tensor | None
    crowding: Tensor | None


class Residual(Protocol):
    """Difference of two measurements, shape (..., M), with angles wrapped."""

    def __call__(self, y: Tensor, y_pred: Tensor) -> Tensor:
        """Return y - y_pred."""
        ...


class Predict(Protocol):
    """Moments of the propagated sigma points (B, S, D), plus additive process noise."""

    def __call__(self, propagated: Tensor, weights: SigmaWeights, chol_q: Tensor) -> Predicted:
        """Return the predicted belief."""
        ...


class Update(Protocol):
    """Condition a prior on the measurement row y (B, M), NaN where a component is missing."""

    def __call__(
        self,
        prior: Belief,
        images: Tensor,
        y: Tensor,
        residual: Residual,
        weights: SigmaWeights,
        chol_r: Tensor,
    ) -> Updated:
        """Return the posterior; images (B, S, M) are the measured sigma points of the prior."""
        ...


class Read(Protocol):
    """Condition a prior on a row y (B, M) of the first M components of the state, without points."""

    def __call__(self, prior: Belief, y: Tensor, weights: SigmaWeights, chol_r: Tensor) -> Updated | None:
        """Return the posterior, or None where only points give it."""
        ...


class Form(NamedTuple):
    """A way to carry the covariance: the functions that the loop over time calls.

    Attributes:
        name: for messages.
        predict: see `Predict`.
        update: see `Update`.
        squares: whether covariances are formed, which loses digits and needs a definite measurement noise.
        read: see `Read`; None where there is none.
    """

    name: str
    predict: Predict
    update: Update
    squares: bool
    read: Read | None = None
