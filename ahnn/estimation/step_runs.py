"""Sequences of steps, filtered in one call until a row may be rejected or a member fail."""

from __future__ import annotations

from typing import NamedTuple, Protocol, runtime_checkable

from torch import Tensor

from ahnn.estimation.estimator import SensorModel
from ahnn.estimation.state import FilterState
from ahnn.types import Flow


class StepRun(NamedTuple):
    """S steps of B members, of which K end with a measured row.

    Attributes:
        starts: (S,) times at which steps begin.
        lengths: (S,) their lengths.
        chol_q: (S or 1, B or 1, D, D) factors of the process noise.
        measured: S flags, whether a row is measured at the end of the step.
        rows: (K, B, M) rows without missing components.
    """

    starts: Tensor
    lengths: Tensor
    chol_q: Tensor
    measured: list[bool]
    rows: Tensor


class FollowedRows(NamedTuple):
    """Results of the first n rows of a sequence.

    Attributes:
        means: (n, D) posterior means.
        chols: (n, D, D) lower factors of the posterior covariances.
        residuals: (n, M) innovations.
        deviations: (n, M) their standard deviations.
        nis: (n,) normalised innovation squared.
        log_likelihoods: (n,) log predictive densities of the rows.
    """

    means: Tensor
    chols: Tensor
    residuals: Tensor
    deviations: Tensor
    nis: Tensor
    log_likelihoods: Tensor


@runtime_checkable
class RunFilter(Protocol):
    """Estimator that filters sequences of steps in one call."""

    def follow(
        self, state: FilterState, flow: Flow, run: StepRun, sensor: SensorModel, most: float
    ) -> FollowedRows | None:
        """Filter the first rows of a sequence, bit-identical to `predict` and `update` step by step.

        The call ends before the first row that single steps would not simply accept.

        Args:
            state: state of one member before the sequence.
            flow: the process model.
            run: its steps and rows.
            sensor: measurement model of the rows.
            most: NIS above which the call ends, whatever the gate.

        Returns:
            The results of the filtered rows; None where sequences are not supported.
        """
        ...
