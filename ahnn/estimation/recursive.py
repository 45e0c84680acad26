"""What a recursive estimator is: it starts from a belief, predicts, and is corrected by measurements."""

from __future__ import annotations

from typing import NamedTuple, Protocol, TypeVar

from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.covariances import Covariance
from ahnn.measurements.base import Measurement
from ahnn.numbers import Numbers
from ahnn.types import Flow

State = TypeVar("State")


class Innovation(NamedTuple):
    """What one measurement row told, for each of B members; NaN for a member that has failed.

    Attributes:
        residual: (B, M) measurement less prediction, NaN where a component is missing.
        deviation: (B, M) standard deviations of the residuals under the prediction and R, of those that are
            there.
        nis: (B,) normalised innovation squared of the components that are there, of rejected rows too; NaN
            where nothing is there.
        measured: (B,) int64, components that are there.
        rejected: (B,) bool, the gate refused the row.
        log_likelihood: (B,) log density of the row under the prediction where it was accepted, else 0.
    """

    residual: Tensor
    deviation: Tensor
    nis: Tensor
    measured: Tensor
    rejected: Tensor
    log_likelihood: Tensor


class Recursive(Protocol[State]):
    """An estimator that steps: pure functions of a state that carries everything.

    A state is a NamedTuple of float64 and int64 tensors for a batch of B members.
    """

    def start(self, belief: Belief, time: float = 0.0) -> State:
        """Return the state of a belief that holds at a time."""
        ...

    def predict(self, state: State, flow: Flow, dt: float, process_noise: Covariance) -> State:
        """Return the state after a step dt of the flow, with covariance Q of that step added."""
        ...

    def update(
        self, state: State, y: Numbers, measurement: Measurement, measurement_noise: Covariance
    ) -> tuple[State, Innovation]:
        """Return the state given a row y (B, M) measured at the state's time with covariance R.

        NaN is what was not measured. Sensors that report at the same time are updates one after the other; a
        measurement at the start is an update before the first prediction.
        """
        ...
