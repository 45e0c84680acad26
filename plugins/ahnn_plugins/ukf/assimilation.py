"""A filter as an evaluation tries it: a process model with its constants, run on a problem."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.belief import Belief
from ahnn.estimation.covariances import initial_belief
from ahnn.estimation.gate import Gate
from ahnn.estimation.scenario import Problem, Setting
from ahnn.measurements import Measurement
from ahnn.progress import progress_bar
from ahnn.types import Flow, TimeStep
from ahnn_plugins.ukf.batch import BatchResult, batch_least_squares
from ahnn_plugins.ukf.filter import unscented_filter
from ahnn_plugins.ukf.force_error import ForceError, of_states, smoothed_states
from ahnn_plugins.ukf.iterated import Iterated, iterated_smoother
from ahnn_plugins.ukf.parameter_error import ParameterError
from ahnn_plugins.ukf.smoother import unscented_smoother
from ahnn_plugins.ukf.square_root import SQUARE_ROOT
from ahnn_plugins.ukf.types import FilterResult, Form, SmootherResult, UnscentedParameters


class Filter(NamedTuple):
    """A process model and what it is believed to be worth.

    Attributes:
        name: in tables.
        flow: the process model.
        process_noise: Q of one step, (D, D) or (B, D, D).
        measurement_noise: R, (M, M) or (B, M, M).
        parameters: of the sigma points.
        form: square-root or standard.
        gate: refuses improbable measurements; None takes all.
        floor: whether the flow is perfect knowledge.
        force_error: of the force, relative and with memory, or of the parameters, besides Q; None for none.
    """

    name: str
    flow: Flow
    process_noise: Tensor
    measurement_noise: Tensor
    parameters: UnscentedParameters
    form: Form = SQUARE_ROOT
    gate: Gate | None = None
    floor: bool = False
    force_error: ForceError | ParameterError | None = None

    def scaled(self, q: Tensor | float, r: Tensor | float = 1.0) -> Filter:
        """Return the filter with factors of all its process noise and of R, numbers or (B,)."""
        error = self.force_error
        return self._replace(
            process_noise=_times(q, self.process_noise),
            measurement_noise=_times(r, self.measurement_noise),
            force_error=None if error is None else error._replace(size=q**0.5 * error.size),
        )


def _times(factor: Tensor | float, matrix: Tensor) -> Tensor:
    return matrix * (factor[:, None, None] if isinstance(factor, Tensor) else factor)


class _Model(NamedTuple):
    """What `unscented_filter` is given first: of the states themselves, or augmented by a force error."""

    flow: Flow
    belief: Belief
    measurements: Tensor
    measurement: Measurement
    process_noise: Tensor
    measurement_noise: Tensor
    dt: float


def assimilate(chosen: Filter, setting: Setting, problem: Problem) -> FilterResult:
    """Run a filter on a problem."""
    result = _filtered(chosen, _model(chosen, setting, problem))
    return result if chosen.force_error is None else of_states(result, problem.truth.shape[-1])


class Behind(NamedTuple):
    """Estimators that know all measurements, beside a filter; None where one is not asked for.

    Attributes:
        smoothed: by the Rauch-Tung-Striebel smoother.
        iterated: by the iterated smoother.
        batch: by batch least squares, which takes the flow as exact.
    """

    smoothed: SmootherResult
    iterated: Iterated | None = None
    batch: BatchResult | None = None


def assimilate_all(
    chosen: Filter, setting: Setting, problem: Problem, *, iterated: bool = False, batch: bool = False
) -> tuple[FilterResult, Behind]:
    """Run a filter on a problem, the smoother behind it, and what else is asked for.

    Rows that the gate of the filter refused count for none of them.
    """
    model = _model(chosen, setting, problem)
    result = _filtered(chosen, model, smoothing=True)
    behind = Behind(unscented_smoother(result))
    if iterated:
        relinearised = iterated_smoother(result, model.flow, *model[2:], parameters=chosen.parameters)
        behind = behind._replace(iterated=relinearised)
    if chosen.force_error is not None:
        size = problem.truth.shape[-1]
        result, behind = of_states(result, size), _states_behind(behind, size)
    if batch:
        belief = initial_belief(problem.starts, setting.start_covariance)
        rows = problem.measurements.masked_fill(result.rejected.unsqueeze(-1), torch.nan)
        noise = chosen.measurement_noise
        fit = batch_least_squares(chosen.flow, belief, rows, setting.measurement, noise, problem.dt)
        behind = behind._replace(batch=fit)
    return result, behind


def _states_behind(behind: Behind, size: int) -> Behind:
    """Return what is said of the states alone."""
    smoothed, iterated, _ = behind
    if iterated is not None:
        iterated = iterated._replace(smoothed=smoothed_states(iterated.smoothed, size))
    return Behind(smoothed_states(smoothed, size), iterated)


def _model(chosen: Filter, setting: Setting, problem: Problem) -> _Model:
    belief, rows = initial_belief(problem.starts, setting.start_covariance), problem.measurements
    q, r, error = chosen.process_noise, chosen.measurement_noise, chosen.force_error
    if error is None:
        return _Model(chosen.flow, belief, rows, setting.measurement, q, r, problem.dt)
    flow, measurement = error.flow(chosen.flow), error.measurement(setting.measurement)
    q = error.process_noise(q, problem.dt)
    return _Model(flow, error.belief(belief), rows, measurement, q, r, problem.dt)


def _filtered(chosen: Filter, model: _Model, *, smoothing: bool = False) -> FilterResult:
    constants = {"parameters": chosen.parameters, "form": chosen.form, "gate": chosen.gate}
    return unscented_filter(*model, **constants, smoothing=smoothing)


@contextmanager
def shown(flow: Flow, description: str, calls: int) -> Iterator[Flow]:
    """Give a flow that moves a progress bar at each of its `calls` calls."""
    with progress_bar() as bar:
        task = bar.add_task(description, total=calls)

        def counted(x: Tensor, dt: TimeStep) -> Tensor:
            bar.advance(task)
            return flow(x, dt)

        yield counted
