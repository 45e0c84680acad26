"""Unscented Kalman filter, for single steps or batches of rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, cast, final

import torch
from torch import Tensor

from ahnn.errors import UserError
from ahnn.estimation.belief import Belief, Status
from ahnn.estimation.covariances import Covariance
from ahnn.estimation.estimator import Batch, Kernel, SensorModel, Smoothed
from ahnn.estimation.gate import Gate
from ahnn.estimation.gaussian import GaussianFilter
from ahnn.estimation.loop import FilterLoop, RunPlan
from ahnn.estimation.results import FilterResult, ProcessNoise
from ahnn.estimation.state import FilterState
from ahnn.estimation.step_runs import FollowedRows, StepRun
from ahnn.measurements.base import Measurement
from ahnn.numbers import Numbers
from ahnn.types import Flow
from ahnn_plugins.ukf import library_runs
from ahnn_plugins.ukf.iterated import iterated_smoother
from ahnn_plugins.ukf.parameters import Form, SigmaWeights, UnscentedParameters
from ahnn_plugins.ukf.sigma_points import unscented_weights
from ahnn_plugins.ukf.square_root import SQUARE_ROOT
from ahnn_plugins.ukf.unscented_kernel import SigmaPoints
from ahnn_plugins.ukf.whole_steps import WholeSteps

DEFAULTS = UnscentedParameters()


@final
@dataclass(frozen=True)
class UnscentedKalmanFilter(GaussianFilter):
    """Unscented Kalman filter with additive noise for a batch of B members, see `GaussianFilter`.

    Attributes:
        parameters: sigma point parameters.
        form: `SQUARE_ROOT` or `STANDARD`.
        gate: gate for improbable measurement rows, or None.
        name: name in tables.

    Raises:
        ValueError: invalid form or gate.
    """

    parameters: UnscentedParameters = DEFAULTS
    form: Form = SQUARE_ROOT
    gate: Gate | None = None
    name: str = "ukf"  # pyright: ignore[reportIncompatibleMethodOverride] - property of the base class

    def __post_init__(self) -> None:
        """Check the form and the gate."""
        if not isinstance(self.form, Form):
            message = f"form: expected a Form, SQUARE_ROOT or STANDARD; received {self.form!r}"
            raise UserError(message)
        super().__post_init__()

    @property
    def definite(self) -> bool:
        """Whether covariances are formed, which requires definite measurement noise."""
        return self.form.squares

    @property
    def about(self) -> dict[str, Any]:
        """Plain values that determine the estimates."""
        parameters = [float(value) for value in self.parameters]
        return {"parameters": parameters, "form": self.form.name, "gate": self.gate}

    @property
    def smoothers(self) -> dict[str, Callable[[FilterResult, Batch], Smoothed]]:
        """Rauch-Tung-Striebel smoother, and the iterated smoother."""
        return {**super().smoothers, "iterated": self._iterated}

    def _iterated(self, result: FilterResult, batch: Batch) -> Smoothed:
        """Run the iterated smoother."""
        found = iterated_smoother(result, batch.flow, *batch[2:], parameters=self.parameters)
        unsettled = int((~found.settled & (result.status == Status.OK)).sum())
        return Smoothed(found.smoothed, {"iterations": found.iterations, "unsettled": unsettled})

    def kernel(self, belief: Belief) -> SigmaPoints:
        """Build the sigma points for states of this size."""
        (batch, size), device = belief.mean.shape, belief.mean.device
        if any(isinstance(value, Tensor) for value in self.parameters):
            return SigmaPoints(unscented_weights(self.parameters, size, device, batch=batch), self.form)
        return SigmaPoints(_weights_of_numbers(self.parameters, size, device), self.form)

    def follow(
        self, state: FilterState, flow: Flow, run: StepRun, sensor: SensorModel, most: float
    ) -> FollowedRows | None:
        """Filter the first rows of a sequence; see `ahnn.estimation.step_runs.RunFilter`."""
        return library_runs.follow(state, self.kernel(state.belief), flow, run, sensor, most)

    def stepper(self, kernel: Kernel, plan: RunPlan, *, smoothing: bool) -> FilterLoop[FilterState]:
        """Return the step function of a run, with fused steps if supported by the library."""
        return WholeSteps(plan, cast(SigmaPoints, kernel), smoothing=smoothing)


@cache
def _weights_of_numbers(parameters: UnscentedParameters, size: int, device: torch.device) -> SigmaWeights:
    # Cached tensors must support gradients, regardless of the mode of the first request.
    with torch.inference_mode(mode=False), torch.no_grad():
        return unscented_weights(parameters, size, device)


def unscented_filter(
    flow: Flow,
    belief: Belief | FilterState,
    measurements: Numbers,
    measurement: Measurement,
    process_noise: ProcessNoise,
    measurement_noise: Covariance,
    dt: Numbers,
    *,
    parameters: UnscentedParameters | None = None,
    form: Form = SQUARE_ROOT,
    gate: Gate | None = None,
    smoothing: bool = False,
    start_time: float = 0.0,
    gradients: bool = False,
) -> FilterResult:
    """Run an unscented Kalman filter over a batch of trajectories: `GaussianFilter.run` in one call.

    Args:
        flow: any function (x (N, D), dt) -> (N, D); called once per step, with N = B (2 D + 1).
        belief: see `GaussianFilter.run`, also for the following arguments.
        measurements: (B, T, M), NaN where a component is missing.
        measurement: measurement model.
        process_noise: covariance Q of one step, (D, D) or (B, D, D), or a function of the step's length.
        measurement_noise: covariance R, (M, M) or (B, M, M).
        dt: length of every step, or (T,) lengths; positive.
        parameters: sigma point parameters; None for the defaults of `UnscentedParameters`.
        form: `SQUARE_ROOT` or `STANDARD`.
        gate: gate for improbable measurement rows, or None.
        smoothing: whether to keep the backward laws for `unscented_smoother`.
        start_time: time of the initial belief; ignored for a state.
        gradients: whether to keep the graph.

    Raises:
        ValueError: the same errors as `GaussianFilter.run`, or parameters without sigma points.
    """
    estimator = UnscentedKalmanFilter(parameters or DEFAULTS, form, gate)
    rows = measurements, measurement, process_noise, measurement_noise, dt
    options = {"smoothing": smoothing, "start_time": start_time, "gradients": gradients}
    return estimator.run(flow, belief, *rows, **options)
