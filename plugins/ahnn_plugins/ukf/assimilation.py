"""A filter as an evaluation tries it: a process model with its constants, run on a problem."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from torch import Tensor

from ahnn.estimation.covariances import initial_belief
from ahnn.estimation.gate import Gate
from ahnn.estimation.scenario import Problem, Setting
from ahnn.progress import progress_bar
from ahnn.types import Flow, TimeStep
from ahnn_plugins.ukf.filter import unscented_filter
from ahnn_plugins.ukf.square_root import SQUARE_ROOT
from ahnn_plugins.ukf.types import FilterResult, Form, UnscentedParameters


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
    """

    name: str
    flow: Flow
    process_noise: Tensor
    measurement_noise: Tensor
    parameters: UnscentedParameters
    form: Form = SQUARE_ROOT
    gate: Gate | None = None
    floor: bool = False


def assimilate(
    chosen: Filter, setting: Setting, problem: Problem, *, smoothing: bool = False
) -> FilterResult:
    """Run a filter on a problem."""
    belief = initial_belief(problem.starts, setting.start_covariance)
    return unscented_filter(
        chosen.flow,
        belief,
        problem.measurements,
        setting.measurement,
        chosen.process_noise,
        chosen.measurement_noise,
        problem.dt,
        parameters=chosen.parameters,
        form=chosen.form,
        gate=chosen.gate,
        smoothing=smoothing,
    )


@contextmanager
def shown(flow: Flow, description: str, calls: int) -> Iterator[Flow]:
    """Give a flow that moves a progress bar at each of its `calls` calls."""
    with progress_bar() as bar:
        task = bar.add_task(description, total=calls)

        def counted(x: Tensor, dt: TimeStep) -> Tensor:
            bar.advance(task)
            return flow(x, dt)

        yield counted
