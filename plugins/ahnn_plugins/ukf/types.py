"""Values that the filter takes and returns; shape suffixes as in `ahnn.types`."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.covariances import Covariance
from ahnn.estimation.state import FilterState


class UnscentedParameters(NamedTuple):
    """Parameters of the scaled unscented transformation (Wan & van der Merwe 2000).

    Each is one number, or a (B,) tensor with one value per member. The defaults give no negative weight;
    beta = 2 is optimal for Gaussian beliefs.
    """

    alpha: float | Tensor = 1.0
    beta: float | Tensor = 2.0
    kappa: float | Tensor = 0.0


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


class Predicted(NamedTuple):
    """Result of one prediction.

    Attributes:
        belief: the prior of the next update.
        repaired: (B,) bool, or None where the form had nothing to repair.
        sound: all members are known to be finite with positive variances; False where nobody looked.
    """

    belief: Belief
    repaired: Tensor | None
    sound: bool = False


class Updated(NamedTuple):
    """Result of one update.

    Attributes:
        belief: the posterior.
        innovation: (B, M), zero where the component is missing.
        deviation: (B, M) its standard deviations, one where the component is missing.
        nis: (B,) normalised innovation squared of the components that are there.
        log_likelihood: (B,) log density of those components under the prediction.
        singular: (B,) bool, the innovation covariance cannot be inverted, or the posterior has a variance
            that is not positive.
        repairs: (B,) int64, covariances that were mended, or None where the form had nothing to repair.
        sound: all members are known to have a whole row, finite numbers and nothing singular; False where
            nobody looked.
    """

    belief: Belief
    innovation: Tensor
    deviation: Tensor
    nis: Tensor
    log_likelihood: Tensor
    singular: Tensor
    repairs: Tensor | None
    sound: bool = False


class Residual(Protocol):
    """Difference of two measurements, shape (..., M), with angles wrapped."""

    def __call__(self, y: Tensor, y_pred: Tensor) -> Tensor:
        """Return y - y_pred."""
        ...


class Predict(Protocol):
    """Moments of the propagated sigma points (B, S, D), plus additive process noise."""

    def __call__(self, propagated: Tensor, weights: Weights, chol_q: Tensor) -> Predicted:
        """Return the predicted belief."""
        ...


class Update(Protocol):
    """Condition a prior on the measurement row y (B, M), NaN where a component is missing."""

    def __call__(
        self, prior: Belief, images: Tensor, y: Tensor, residual: Residual, weights: Weights, chol_r: Tensor
    ) -> Updated:
        """Return the posterior; images (B, S, M) are the measured sigma points of the prior."""
        ...


class Read(Protocol):
    """Condition a prior on a row y (B, M) of the first M components of the state, without points."""

    def __call__(self, prior: Belief, y: Tensor, weights: Weights, chol_r: Tensor) -> Updated | None:
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


class Backward(NamedTuple):
    """Law of the state before a step given the state after it: N(mean + gain (x' - mean'), chol cholᵀ).

    Attributes:
        gain: (B, T, D, D) smoother gains.
        chol: (B, T, D, D) lower factors of the conditional covariance.
    """

    gain: Tensor
    chol: Tensor


class FilterResult(NamedTuple):
    """What `unscented_filter` returns; index k is after step k, at time t_0 + dt_0 + ... + dt_k.

    A member whose status is not OK holds NaN from its failed step on, and its estimates up to there.

    Attributes:
        initial: belief before the first step.
        means: (B, T, D) after the update.
        chols: (B, T, D, D) lower factors after the update.
        predicted_means: (B, T, D) before the update; equal to `means` where nothing was measured.
        predicted_chols: (B, T, D, D) before the update.
        innovations: (B, T, M), NaN where missing.
        nis: (B, T) normalised innovation squared, of rejected rows too; NaN where nothing was measured.
        measured: (B, T) int64, components that were there.
        rejected: (B, T) bool, the gate refused the row.
        log_likelihood: (B,) of the accepted measurements.
        status: (B,) int64, see `Status`.
        failed_step: (B,) int64, step of this run at which the status was given, 0 if before it; -1 where it
            is OK.
        repairs: (B,) int64, covariances that had to be mended, and backward kernels of a covariance that
            was singular.
        backward: kernels for the smoother, where they were asked for.
        state: after the last step, from which the next measurements go on. Log-likelihood, status and repairs
            are its own: in a run that began with a state they count from where that state began.
    """

    initial: Belief
    means: Tensor
    chols: Tensor
    predicted_means: Tensor
    predicted_chols: Tensor
    innovations: Tensor
    nis: Tensor
    measured: Tensor
    rejected: Tensor
    log_likelihood: Tensor
    status: Tensor
    failed_step: Tensor
    repairs: Tensor
    backward: Backward | None
    state: FilterState

    @property
    def covariances(self) -> Tensor:
        """Covariances (B, T, D, D) after the update."""
        return self.chols @ self.chols.mT


class SmootherResult(NamedTuple):
    """What `unscented_smoother` returns.

    Attributes:
        initial: smoothed belief about the start.
        means: (B, T, D) given all measurements.
        chols: (B, T, D, D) lower factors.
        status: (B,) int64, that of the filter, see `Status`.
        repairs: (B,) int64, those of the filter and of its backward kernels.
    """

    initial: Belief
    means: Tensor
    chols: Tensor
    status: Tensor
    repairs: Tensor

    @property
    def covariances(self) -> Tensor:
        """Covariances (B, T, D, D)."""
        return self.chols @ self.chols.mT


ProcessNoise = Covariance | Callable[[float], Covariance]
"""Covariance Q of one step, (D, D) or (B, D, D), or a function of the length of the step that returns it."""
