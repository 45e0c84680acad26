"""The unscented Kalman filter, one step at a time or over a batch of rows."""

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
from ahnn.estimation.estimator import Batch, Kernel, Smoothed
from ahnn.estimation.gate import Gate
from ahnn.estimation.gaussian import GaussianFilter
from ahnn.estimation.loop import FilterLoop
from ahnn.estimation.results import FilterResult, ProcessNoise
from ahnn.estimation.state import FilterState
from ahnn.measurements.base import Measurement
from ahnn.numbers import Numbers
from ahnn.types import Flow
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
        parameters: of the sigma points.
        form: `SQUARE_ROOT` or `STANDARD`.
        gate: refuses improbable measurement rows; None takes all.
        name: what its rows are called.

    Raises:
        ValueError: a form or a gate that is none.
    """

    parameters: UnscentedParameters = DEFAULTS
    form: Form = SQUARE_ROOT
    gate: Gate | None = None
    name: str = "ukf"  # pyright: ignore[reportIncompatibleMethodOverride] - a property of the base

    def __post_init__(self) -> None:
        """Refuse what is no form and no gate."""
        if not isinstance(self.form, Form):
            message = f"form: expected a Form, SQUARE_ROOT or STANDARD; received {self.form!r}"
            raise UserError(message)
        super().__post_init__()

    @property
    def definite(self) -> bool:
        """Whether covariances are formed, which needs a definite measurement noise."""
        return self.form.squares

    @property
    def about(self) -> dict[str, Any]:
        """Plain values that determine its estimates."""
        parameters = [float(value) for value in self.parameters]
        return {"parameters": parameters, "form": self.form.name, "gate": self.gate}

    @property
    def smoothers(self) -> dict[str, Callable[[FilterResult, Batch], Smoothed]]:
        """The Rauch-Tung-Striebel smoother, and the iterated one."""
        return {**super().smoothers, "iterated": self._iterated}

    def _iterated(self, result: FilterResult, batch: Batch) -> Smoothed:
        """Return what the iterated smoother finds."""
        found = iterated_smoother(result, batch.flow, *batch[2:], parameters=self.parameters)
        unsettled = int((~found.settled & (result.status == Status.OK)).sum())
        return Smoothed(found.smoothed, {"iterations": found.iterations, "unsettled": unsettled})

    def kernel(self, belief: Belief) -> SigmaPoints:
        """Return sigma points for states of this size."""
        (batch, size), device = belief.mean.shape, belief.mean.device
        if any(isinstance(value, Tensor) for value in self.parameters):
            return SigmaPoints(unscented_weights(self.parameters, size, device, batch=batch), self.form)
        return SigmaPoints(_weights_of_numbers(self.parameters, size, device), self.form)

    def stepper(self, kernel: Kernel, rows: Tensor, *, smoothing: bool) -> FilterLoop[FilterState]:
        """Return the steps of a run, whole ones where the library does them."""
        return WholeSteps(rows, cast(SigmaPoints, kernel), smoothing=smoothing)


@cache
def _weights_of_numbers(parameters: UnscentedParameters, size: int, device: torch.device) -> SigmaWeights:
    # Kept tensors must serve gradients, in whatever mode they are asked for first.
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
        flow: any function (x (N, D), dt) -> (N, D); called once a step, with N = B (2 D + 1).
        belief: see `GaussianFilter.run`, as of what follows.
        measurements: (B, T, M), NaN where a component is missing.
        measurement: the model of the measurements.
        process_noise: Q of one step, (D, D) or (B, D, D), or a function of the step's length.
        measurement_noise: R, (M, M) or (B, M, M).
        dt: length of every step, or (T,) lengths; positive.
        parameters: of the sigma points; the defaults of `UnscentedParameters` if None.
        form: `SQUARE_ROOT` or `STANDARD`.
        gate: refuses improbable measurement rows; None takes all.
        smoothing: keep what `unscented_smoother` needs.
        start_time: time of the initial belief; a state has its own.
        gradients: keep the graph.

    Raises:
        ValueError: as `GaussianFilter.run`, and for parameters without sigma points.
    """
    estimator = UnscentedKalmanFilter(parameters or DEFAULTS, form, gate)
    rows = measurements, measurement, process_noise, measurement_noise, dt
    options = {"smoothing": smoothing, "start_time": start_time, "gradients": gradients}
    return estimator.run(flow, belief, *rows, **options)
