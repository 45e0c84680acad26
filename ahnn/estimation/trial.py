"""Trial of an estimator in an evaluation: process model and constants, run on a problem."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.dynamics.flow_at_time import at
from ahnn.dynamics.transition import transition
from ahnn.estimation.batch_least_squares import BatchResult, batch_least_squares
from ahnn.estimation.covariances import initial_belief
from ahnn.estimation.estimator import Batch, Estimator, Smoothed
from ahnn.estimation.force_error import ForceError, of_states, smoothed_states
from ahnn.estimation.parameter_error import ParameterError
from ahnn.estimation.results import FilterResult
from ahnn.estimation.scenario import Problem, Setting
from ahnn.progress import advancing
from ahnn.rollouts import clock_of
from ahnn.types import Flow, TimeStep


class Filter(NamedTuple):
    """Process model with noise covariances and an estimator.

    Attributes:
        name: name in tables.
        flow: the process model.
        process_noise: covariance Q of one step, (D, D) or (B, D, D).
        measurement_noise: covariance R, (M, M) or (B, M, M).
        estimator: estimator with its gate.
        force_error: error model in addition to Q: of the force, relative and with memory, or of the
            parameters; or None.
    """

    name: str
    flow: Flow
    process_noise: Tensor
    measurement_noise: Tensor
    estimator: Estimator
    force_error: ForceError | ParameterError | None = None

    def scaled(self, q: Tensor | float, r: Tensor | float = 1.0) -> Filter:
        """Scale the process noise and R of the filter by factors, numbers or (B,)."""
        error = self.force_error
        return self._replace(
            process_noise=_times(q, self.process_noise),
            measurement_noise=_times(r, self.measurement_noise),
            force_error=None if error is None else error._replace(size=q**0.5 * error.size),
        )


def _times(factor: Tensor | float, matrix: Tensor) -> Tensor:
    return matrix * (factor[:, None, None] if isinstance(factor, Tensor) else factor)


def assimilate(chosen: Filter, setting: Setting, problem: Problem) -> FilterResult:
    """Run a filter on a problem."""
    result = chosen.estimator.run(*_batch(chosen, setting, problem))
    return of_states(result, problem.truth.shape[-1]) if _augments(chosen, setting) else result


class Behind(NamedTuple):
    """Results of estimators that use all measurements, obtained in addition to those of a filter.

    Attributes:
        smoothed: results of the requested smoothers, by name.
        batch: result of batch least squares, which assumes an exact flow; None if not requested.
    """

    smoothed: dict[str, Smoothed]
    batch: BatchResult | None = None


def assimilate_all(
    chosen: Filter, setting: Setting, problem: Problem, smoothers: Sequence[str], *, batch: bool = False
) -> tuple[FilterResult, Behind]:
    """Run a filter, its smoothers and the other requested estimators on a problem.

    Rows rejected by the filter's gate are ignored by all of them.
    """
    model, known = _batch(chosen, setting, problem), chosen.estimator.smoothers
    result = chosen.estimator.run(*model, smoothing=bool(smoothers))
    behind = {name: known[name](result, model) for name in smoothers}
    if _augments(chosen, setting):
        size = problem.truth.shape[-1]
        result = of_states(result, size)
        behind = {k: s._replace(beliefs=smoothed_states(s.beliefs, size)) for k, s in behind.items()}
    if not batch:
        return result, Behind(behind)
    exact = _batch(chosen._replace(force_error=None), setting, problem)
    rows = exact.measurements.masked_fill(result.rejected.unsqueeze(-1), torch.nan)
    noise = exact.measurement_noise
    fit = batch_least_squares(exact.flow, exact.belief, rows, exact.measurement, noise, exact.dt)
    return result, Behind(behind, fit.of_states(problem.truth.shape[-1]))


def _batch(chosen: Filter, setting: Setting, problem: Problem) -> Batch:
    """Build the batch of an estimator, with plain states or states augmented by errors."""
    belief, rows = initial_belief(problem.starts, setting.start_covariance), problem.measurements
    q, r = chosen.process_noise, chosen.measurement_noise
    batch = Batch(problem.driven(chosen.flow), belief, rows, setting.measurement, q, r, problem.dt)
    for error in (chosen.force_error, setting.sensor_error):
        if error is not None:
            batch = batch._replace(
                flow=error.flow(batch.flow),
                belief=error.belief(batch.belief),
                measurement=error.measurement(batch.measurement),
                process_noise=error.process_noise(batch.process_noise, batch.dt),
            )
    return batch


def _augments(chosen: Filter, setting: Setting) -> bool:
    """Return whether the estimated state is augmented."""
    return chosen.force_error is not None or setting.sensor_error is not None


@contextmanager
def shown(flow: Flow, description: str, calls: int) -> Iterator[Flow]:
    """Yield a flow that advances a progress bar at each of its `calls` calls."""
    with advancing(description, calls) as advance:
        yield _Shown(flow, advance)


class _Shown(NamedTuple):
    """Flow that reports its calls."""

    flow: Flow
    advance: Callable[[], None]

    @property
    def clock(self) -> int:
        """Number of clock coordinates of its states."""
        return clock_of(self.flow)

    def at(self, time: float | Tensor) -> Flow:
        """Bind the flow to a start time."""
        return _Shown(at(self.flow, time), self.advance)

    def __call__(self, x: Tensor, dt: TimeStep) -> Tensor:
        """Return the states after dt."""
        self.advance()
        return self.flow(x, dt)

    def transition(self, x: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """Return the states after dt, and the state transitions."""
        self.advance()
        return transition(self.flow, x, dt)
