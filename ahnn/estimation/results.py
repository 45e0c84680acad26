"""Results of Gaussian filters and smoothers; shape suffixes as in `ahnn.types`."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.covariances import Covariance
from ahnn.estimation.state import MemberState


class Backward(NamedTuple):
    """Backward law: given the next state x', the state before is N(mean + gain (x' - mean'), chol cholᵀ).

    Attributes:
        gain: (B, T, D, D) smoother gains.
        chol: (B, T, D, D) lower factors of the conditional covariance.
    """

    gain: Tensor
    chol: Tensor


class Predicted(NamedTuple):
    """Result of one prediction.

    Attributes:
        belief: prior of the next update.
        repaired: (B,) bool, repaired members, or None without repairs.
        sound: whether all members are known to be finite with positive variances; False if unchecked.
        backward: backward law of the step, (B, D, D), if requested.
        mended: (B,) bool, whether the backward law itself was repaired; None without repairs.
    """

    belief: Belief
    repaired: Tensor | None = None
    sound: bool = False
    backward: Backward | None = None
    mended: Tensor | None = None


class Updated(NamedTuple):
    """Result of one update.

    Attributes:
        belief: posterior.
        innovation: (B, M), zero where the component is missing.
        deviation: (B, M) standard deviations of the innovation, one where the component is missing.
        nis: (B,) normalised innovation squared of the available components.
        log_likelihood: (B,) log predictive density of these components.
        singular: (B,) bool, the innovation covariance is singular, or the posterior has a variance that is
            not positive.
        repairs: (B,) int64, number of repaired covariances, or None without repairs.
        sound: whether all members are known to have a complete row, finite numbers and no singularity; False
            if unchecked.
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
    """Filter result for a batch of rows; index k is after step k, at time t_0 + dt_0 + ... + dt_k.

    Values of a member whose status is not OK are NaN from the failed step on, and valid before.

    Attributes:
        initial: belief before the first step.
        means: (B, T, D) means after the update.
        chols: (B, T, D, D) lower factors after the update.
        predicted_means: (B, T, D) means before the update; equal to `means` without measurements.
        predicted_chols: (B, T, D, D) lower factors before the update.
        innovations: (B, T, M) innovations, NaN where missing.
        nis: (B, T) normalised innovation squared, including rejected rows; NaN without measurements.
        measured: (B, T) int64, number of measured components.
        rejected: (B, T) bool, whether the gate rejected the row.
        log_likelihood: (B,) log-likelihood of the accepted measurements.
        status: (B,) int64, see `Status`.
        failed_step: (B,) int64, step of this run at which the member failed, 0 if before the run; -1 if OK.
        repairs: (B,) int64, number of repaired covariances, and of backward laws with singular covariances.
        backward: backward laws for the smoother, if requested.
        state: state after the last step, for continuation. Its log-likelihood, status and repairs include the
            values of the state from which the run began.
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
    """Smoother result.

    Attributes:
        initial: smoothed belief about the initial state.
        means: (B, T, D) means given all measurements.
        chols: (B, T, D, D) lower factors.
        status: (B,) int64, status of the filter, see `Status`.
        repairs: (B,) int64, number of repairs in the filter, including its backward laws.
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
"""Covariance Q of one step, (D, D) or (B, D, D), or a function from the step length to Q."""
