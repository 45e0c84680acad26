"""What an estimator is, in protocols as small as their users.

    State       what it carries between two calls: a NamedTuple of tensors, so that any of them is saved and
                restored bit for bit (`save_state`). It has a time, a status of each member, and moments.
    Recursive   start, predict, update: pure functions of a state. Streams take no more (`ahnn.assimilation`).
    Estimator   a Recursive with a name and a gate that also filters whole batches of rows. Evaluations, the
                fits of process noise and the figures take this (`ahnn.evaluation.estimators`).
    Kernel      the two formulas of a Gaussian filter. `GaussianFilter` makes an Estimator of one: arguments,
                gate, missing numbers, status and freezing of members, counts of repairs, smoothing.

What is estimated besides the state (a force error, learned parameters) is put behind its components by
`ahnn.estimation.force_error` and `parameter_error`: an estimator sees longer states and a longer flow.

A new Gaussian filter is one module, with a kernel, and one YAML file that names it; see
`ahnn.evaluation.estimators.EstimatorEvaluation`. Ensembles and particles carry samples, of which others see
the moments: `ahnn.estimation.sample_filter.SampleFilter` is an Estimator of how they are drawn and weighed.
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

    @classmethod
    def of_nothing(cls, y: Tensor) -> Innovation:
        """Return what a row y (B, M) of NaN tells."""
        nothing = torch.zeros(len(y), dtype=torch.int64, device=y.device)
        zeros = nothing.to(y.dtype)
        return cls(y, y, zeros + torch.nan, nothing, nothing.to(torch.bool), zeros)


class RecursiveEstimator(Protocol[S]):
    """An estimator that steps: pure functions of a state that carries everything."""

    @property
    def name(self) -> str:
        """What rows and numbers of it are called, and its node of the configuration, such as `ukf`."""
        ...

    @property
    def about(self) -> dict[str, Any]:
        """Plain values that determine its estimates: a saved state is of no others."""
        ...

    def start(self, belief: Belief, time: float = 0.0) -> S:
        """Return the state of a belief that holds at a time."""
        ...

    def predict(self, state: S, flow: Flow, dt: float, process_noise: Covariance) -> S:
        """Return the state after a step dt of the flow, with covariance Q of that step added."""
        ...

    def update(
        self, state: S, y: Numbers, measurement: Measurement, measurement_noise: Covariance
    ) -> tuple[S, Innovation]:
        """Return the state given a row y (B, M) measured at the state's time with covariance R.

        NaN is what was not measured. Sensors that report at the same time are updates one after the other; a
        measurement at the start is an update before the first prediction.
        """
        ...


class Batch(NamedTuple):
    """Trajectories to filter, and their model, in the order of `Estimator.run`.

    Attributes:
        flow: the process model.
        belief: about the B starts.
        measurements: (B, T, M), NaN where a component is missing.
        measurement: the model of the measurements.
        process_noise: Q of one step.
        measurement_noise: R.
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
    """What a smoother behind a filter found, and numbers of its own for metrics.json."""

    beliefs: SmootherResult
    more: dict[str, Any] = {}  # noqa: RUF012 - never written to


class Estimator(RecursiveEstimator[S], Protocol[S]):
    """A recursive estimator that also takes whole batches of rows."""

    @property
    def smoothers(self) -> Mapping[str, Callable[[FilterResult, Batch], Smoothed]]:
        """Smoothers by name, `smoothed` first: from a run with `smoothing` over a batch to all it knows."""
        ...

    def gated(self, gate: Gate | None) -> Self:
        """Return the same with a gate for improbable rows; None takes all."""
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
        """Return what it makes of rows (B, T, M); row k is measured at the end of step k.

        With `smoothing` the result has the laws that `smoother` composes.
        """
        ...


class SensorModel(NamedTuple):
    """A measurement model and what is believed of it.

    Attributes:
        measurement: the model.
        chol_r: (B, M, M) factor of R.
        thresholds: (M + 1,) largest NIS that is taken, by the number of components that are there; None takes
            all.
        patience: rejections in a row that end a member.
    """

    measurement: Measurement
    chol_r: Tensor
    thresholds: Tensor | None = None
    patience: float = torch.inf


class Kernel(Protocol):
    """What makes a Gaussian filter its own: pure functions of beliefs, of which no member sees another."""

    @property
    def rounding(self) -> Rounding:
        """What it amplifies of the rounding of float64."""
        ...

    def predict(
        self, belief: Belief, flow: Flow, dt: float, chol_q: Tensor, *, smoothing: bool = False
    ) -> Predicted:
        """Return the belief after a step, Q with factor (B, D, D) added; with its backward law if asked."""
        ...

    def update(self, prior: Belief, y: Tensor, sensor: SensorModel, time: float) -> Updated:
        """Return the belief given a row y (B, M), NaN where a component is missing."""
        ...
