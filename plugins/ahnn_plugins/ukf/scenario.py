"""What a filter is asked to estimate in an evaluation: trajectories, noisy measurements, uncertain starts."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.estimation.covariances import initial_belief
from ahnn.progress import progress_bar
from ahnn.statistics import Statistics
from ahnn.types import Flow, TimeStep, Trajectories
from ahnn_plugins.ukf.filter import unscented_filter
from ahnn_plugins.ukf.setting import Setting
from ahnn_plugins.ukf.types import FilterResult, UnscentedParameters

MEASUREMENTS = 1_000_003
"""Added to a seed for the measurement noise: with the seed of the initial errors it would repeat them."""


class Problem(NamedTuple):
    """Trajectories to estimate.

    Attributes:
        truth: (B, T + 1, D), NaN where a trajectory has ended.
        starts: (B, D) what the filter believes at time zero.
        measurements: (B, T, M), NaN where nothing was measured.
        dt: length of a step.
    """

    truth: Tensor
    starts: Tensor
    measurements: Tensor
    dt: float

    def repeated(self, count: int) -> Problem:
        """Return the problem `count` times over, member b of copy i at row i B + b."""
        rows = (part.repeat(count, *[1] * (part.ndim - 1)) for part in self[:3])
        return Problem(*rows, dt=self.dt)


class Filter(NamedTuple):
    """A process model and what it is believed to be worth.

    Attributes:
        name: in tables.
        flow: the process model.
        process_noise: Q of one step, (D, D) or (B, D, D).
        measurement_noise: R, (M, M) or (B, M, M).
        parameters: of the sigma points.
        floor: whether the flow is perfect knowledge.
    """

    name: str
    flow: Flow
    process_noise: Tensor
    measurement_noise: Tensor
    parameters: UnscentedParameters
    floor: bool = False


def simulated(setting: Setting, truth: Tensor, dt: float, seed: int) -> Tensor:
    """Return noisy measurements (B, T, M) of true trajectories (B, T + 1, D), NaN between measurements."""
    batch, samples, _ = truth.shape
    generator = torch.Generator().manual_seed(seed + MEASUREMENTS)
    width = len(setting.measurement.names)
    noise = torch.randn(batch, samples - 1, width, generator=generator, dtype=torch.float64)
    measurements = torch.full_like(noise, torch.nan)
    for k in (k for k in setting.updates if k < samples):
        exact = setting.measurement(truth[:, k], k * dt)
        measurements[:, k - 1] = exact + noise[:, k - 1] * setting.measurement_sd
    return measurements


def validation_problem(
    setting: Setting, validation: Trajectories, count: int, steps: int | None, seed: int
) -> Problem:
    """Return arcs of validation trajectories with perturbed starts, to choose a filter's constants on.

    Args:
        setting: measurements and P0.
        validation: trajectories that no row of the results is computed on.
        count: number of arcs, each from a trajectory of its own.
        steps: length of an arc; arcs that are shorter than their trajectories begin evenly spread over them,
            so that all phases of a motion take part. None takes whole trajectories.
        seed: of the initial errors and the measurements.
    """
    states = validation.states[torch.linspace(0, len(validation.states) - 1, count).long()]
    last = states.shape[1] - 1
    steps = last if steps is None else min(steps, last)
    ends = validation.present.sum(1).min() - 1 - steps
    begin = torch.linspace(0, max(0, int(ends)), count).long()
    truth = states[torch.arange(count)[:, None], begin[:, None] + torch.arange(steps + 1)]
    dt = Statistics.of(validation).dt
    generator = torch.Generator().manual_seed(seed)
    noise = torch.randn(truth[:, 0].shape, generator=generator, dtype=torch.float64)
    measurements = simulated(setting, truth, dt, seed + 1)
    return Problem(truth, truth[:, 0] + noise * setting.start_sd, measurements, dt)


def assimilate(
    chosen: Filter, setting: Setting, problem: Problem, *, smoothing: bool = False
) -> FilterResult:
    """Run a filter on a problem."""
    belief = initial_belief(problem.starts, torch.diag(setting.start_sd**2))
    return unscented_filter(
        chosen.flow,
        belief,
        problem.measurements,
        setting.measurement,
        chosen.process_noise,
        chosen.measurement_noise,
        problem.dt,
        parameters=chosen.parameters,
        form=setting.form,
        gate=setting.gate,
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
