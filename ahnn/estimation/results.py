"""Values that Gaussian filters and smoothers return; shape suffixes as in `ahnn.types`."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.covariances import Covariance
from ahnn.estimation.state import MemberState


class Backward(NamedTuple):
    """Law of the state before a step given the state after it: N(mean + gain (x' - mean'), chol cholᵀ).

    Attributes:
        gain: (B, T, D, D) smoother gains.
        chol: (B, T, D, D) lower factors of the conditional covariance.
    """

    gain: Tensor
    chol: Tensor


class Predicted(NamedTuple):
    """Result of one prediction.

    Attributes:
        belief: the prior of the next update.
        repaired: (B,) bool, or None where there was nothing to repair.
        sound: all members are known to be finite with positive variances; False where nobody looked.
        backward: law of the state before the step given that after it, (B, D, D), where it was asked for.
        mended: (B,) bool, which of these laws needed a repair of their own; None for none.
    """

    belief: Belief
    repaired: Tensor | None = None
    sound: bool = False
    backward: Backward | None = None
    mended: Tensor | None = None


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
        repairs: (B,) int64, covariances that were mended, or None where there was nothing to repair.
        sound: all members are known to have a whole row, finite numbers and nothing singular; False where
            nobody looked.
    """

    belief: Belief
    innovation: Tensor
    deviation: Tensor
    nis: Tensor
    log_likelihood: Tensor
    singular: Tensor
    repairs: Tensor | None = None
    sound: bool = False


class FilterResult(NamedTuple):
    """What a filter returns of a batch of rows; index k is after step k, at time t_0 + dt_0 + ... + dt_k.

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
    state: MemberState

    @property
    def covariances(self) -> Tensor:
        """Covariances (B, T, D, D) after the update."""
        return self.chols @ self.chols.mT


class SmootherResult(NamedTuple):
    """What a smoother returns.

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
