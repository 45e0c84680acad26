"""Estimator protocols, from single steps to batches.

    State       variables carried from one call to the next: a NamedTuple of tensors, so that any state is
                saved and restored exactly (`save_state`), with time, moments and the status of each member.
    Recursive   start, predict, update: pure functions of a state, sufficient for streams
                (`ahnn.assimilation`).
    Estimator   a Recursive with a name and a gate that also filters batches of rows, for evaluations,
                fits of process noise and figures (`ahnn.evaluation.estimators`).
    Kernel      prediction and update formulas of a Gaussian filter. `GaussianFilter` turns a kernel into an
                Estimator: it adds argument checks, gating, missing data, status and freezing of members,
                counts of repairs, and smoothing.

Further estimated quantities (a force error, learned parameters) are appended to the state by
`ahnn.estimation.force_error` and `parameter_error`: an estimator receives augmented states and their flow.

A new Gaussian filter consists of one module with a kernel and one YAML file that names it; see
`ahnn.evaluation.estimators.EstimatorEvaluation`. Ensemble and particle filters carry samples and expose their
moments: `ahnn.estimation.sample_filter.SampleFilter` is an Estimator defined by sampling and weighting rules.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol, Self, TypeVar

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.covariances import Covariance
from ahnn.estimation.gate import Gate
from ahnn.estimation.results import FilterResult, Predicted, ProcessNoise, SmootherResult, Updated
from ahnn.estimation.rounding import Rounding
from ahnn.estimation.state import EstimatorState
from ahnn.measurements.base import Measurement
from ahnn.numbers import Numbers
from ahnn.types import Flow

S = TypeVar("S", bound=EstimatorState)


class Innovation(NamedTuple):
    """Innovation of one measurement row, for each of B members; NaN for a failed member.

    Attributes:
        residual: (B, M) measurement minus prediction, NaN where a component is missing.
        deviation: (B, M) predicted standard deviations of the available residuals, including R.
        nis: (B,) normalised innovation squared of the available components, including rejected rows; NaN
            without measurements.
        measured: (B,) int64, number of available components.
        rejected: (B,) bool, whether the gate rejected the row.
        log_likelihood: (B,) log predictive density of an accepted row, else 0.
    """

    residual: Tensor
    deviation: Tensor
    nis: Tensor
    measured: Tensor
    rejected: Tensor
    log_likelihood: Tensor

    @classmethod
    def of_nothing(cls, y: Tensor) -> Innovation:
        """Return the innovation of an empty row y (B, M) of NaN."""
        nothing = torch.zeros(len(y), dtype=torch.int64, device=y.device)
        zeros = nothing.to(y.dtype)
        return cls(y, y, zeros + torch.nan, nothing, nothing.to(torch.bool), zeros)


class RecursiveEstimator(Protocol[S]):
    """Recursive estimator: pure functions of a self-contained state."""

    @property
    def name(self) -> str:
        """Name in tables and in the configuration, such as `ukf`."""
        ...

    @property
    def about(self) -> dict[str, Any]:
        """Plain values that determine the estimates and must match those of a saved state."""
        ...

    def start(self, belief: Belief, time: float = 0.0) -> S:
        """Return the state for a belief at a given time."""
        ...

    def predict(self, state: S, flow: Flow, dt: float, process_noise: Covariance) -> S:
        """Propagate the state over a step dt of the flow and add the covariance Q of that step."""
        ...

    def update(
        self, state: S, y: Numbers, measurement: Measurement, measurement_noise: Covariance
    ) -> tuple[S, Innovation]:
        """Condition the state on a row y (B, M) measured at the state's time with covariance R.

        NaN marks missing components. Simultaneous sensors are processed by successive updates; a measurement
        at the initial time is an update before the first prediction.
        """
        ...


class Batch(NamedTuple):
    """Trajectories to filter and their models, in the argument order of `Estimator.run`.

    Attributes:
        flow: the process model.
        belief: belief about the B initial states.
        measurements: (B, T, M), NaN where a component is missing.
        measurement: measurement model.
        process_noise: covariance Q of one step.
        measurement_noise: covariance R.
        dt: length of every step.
    """

    flow: Flow
    belief: Belief
    measurements: Tensor
    measurement: Measurement
    process_noise: Tensor
    measurement_noise: Tensor
    dt: float


class Smoothed(NamedTuple):
    """Result of a smoother after a filter, with additional numbers for metrics.json."""

    beliefs: SmootherResult
    more: dict[str, Any] = {}  # noqa: RUF012 - never written to


class Estimator(RecursiveEstimator[S], Protocol[S]):
    """Recursive estimator that also processes batches of rows."""

    @property
    def smoothers(self) -> Mapping[str, Callable[[FilterResult, Batch], Smoothed]]:
        """Smoothers by name, `smoothed` first: functions of a batch run with `smoothing`."""
        ...

    def gated(self, gate: Gate | None) -> Self:
        """Return a copy with a gate for improbable rows; None: no gate."""
        ...

    def run(
        self,
        flow: Flow,
        belief: Belief,
        measurements: Numbers,
        measurement: Measurement,
        process_noise: ProcessNoise,
        measurement_noise: Covariance,
        dt: Numbers,
        *,
        smoothing: bool = False,
    ) -> FilterResult:
        """Filter rows (B, T, M); row k is measured at the end of step k.

        With `smoothing` the result contains the backward laws needed by `smoother`.
        """
        ...


class SensorModel(NamedTuple):
    """Measurement model with its noise and gate.

    Attributes:
        measurement: measurement model.
        chol_r: (B, M, M) factor of R.
        thresholds: (M + 1,) largest accepted NIS by number of available components; None: no gate.
        patience: number of consecutive rejections at which a member fails.
    """

    measurement: Measurement
    chol_r: Tensor
    thresholds: Tensor | None = None
    patience: float = torch.inf


class Kernel(Protocol):
    """Formulas of a Gaussian filter: pure functions of beliefs, independent for each member."""

    @property
    def rounding(self) -> Rounding:
        """Amplification of float64 rounding by the kernel."""
        ...

    def predict(
        self, belief: Belief, flow: Flow, dt: float, chol_q: Tensor, *, smoothing: bool = False
    ) -> Predicted:
        """Propagate the belief and add Q with factor (B, D, D); optionally return the backward law."""
        ...

    def update(self, prior: Belief, y: Tensor, sensor: SensorModel, time: float) -> Updated:
        """Condition the belief on a row y (B, M), NaN where a component is missing."""
        ...
