"""What an estimator is asked in an evaluation: trajectories, noisy measurements of them, uncertain starts."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.dynamics.flow_at_time import steered
from ahnn.estimation.sensor_error import SensorError
from ahnn.measurements.base import Measurement, observe
from ahnn.rollouts import clock_of
from ahnn.types import Flow

MEASUREMENTS = 1_000_003
"""Added to a seed for the measurement noise: with the seed of the initial errors it would repeat them."""


class Setting(NamedTuple):
    """How measurements are made and how uncertain a start is, the same for every model and estimator.

    Attributes:
        measurement: the model of the measurements.
        measurement_sd: (M,) standard deviations, of the simulated noise and of R alike.
        start_sd: (D,) standard deviations of the initial error; P0 is diagonal.
        updates: numbers of the samples that are measured, increasing, from 1.
        sensor_error: biases of the measurements, simulated and estimated; None for none.
    """

    measurement: Measurement
    measurement_sd: Tensor
    start_sd: Tensor
    updates: tuple[int, ...]
    sensor_error: SensorError | None = None

    @property
    def measurement_noise(self) -> Tensor:
        """R, (M, M)."""
        return torch.diag(self.measurement_sd**2)

    @property
    def start_covariance(self) -> Tensor:
        """P0, (D, D)."""
        return torch.diag(self.start_sd**2)

    @property
    def first(self) -> int:
        """The first sample that is measured."""
        return self.updates[0]


class Problem(NamedTuple):
    """Trajectories to estimate.

    Attributes:
        truth: (B, T + 1, D), NaN where a trajectory has ended.
        starts: (B, D) what an estimator believes at time zero.
        measurements: (B, T, M), NaN where nothing was measured.
        dt: length of a step.
        controls: (B, T + 1, m), known; None where nothing is controlled.
        linear: whether controls are interpolated linearly between samples; else they are held.
    """

    truth: Tensor
    starts: Tensor
    measurements: Tensor
    dt: float
    controls: Tensor | None = None
    linear: bool = False

    def repeated(self, count: int) -> Problem:
        """Return the problem `count` times over, member b of copy i at row i B + b."""
        parts = self.truth, self.starts, self.measurements, self.controls
        rows = (None if part is None else part.repeat(count, *[1] * (part.ndim - 1)) for part in parts)
        return self._replace(**dict(zip(("truth", "starts", "measurements", "controls"), rows, strict=True)))

    def driven(self, flow: Flow) -> Flow:
        """Return a process model under the controls; one that needs none comes back as it is."""
        if self.controls is None or clock_of(flow) < 2:
            return flow
        times = self.dt * torch.arange(self.controls.shape[1], dtype=torch.float64)
        return steered(flow, times, self.controls.nan_to_num(), linear=self.linear)


def simulated(setting: Setting, truth: Tensor, dt: float, seed: int) -> Tensor:
    """Return noisy measurements (B, T, M) of true trajectories (B, T + 1, D).

    NaN between measurements, and where a state is out of the instrument's view.
    """
    batch, samples, _ = truth.shape
    generator = torch.Generator().manual_seed(seed + MEASUREMENTS)
    width = len(setting.measurement.names)
    noise = torch.randn(batch, samples - 1, width, generator=generator, dtype=torch.float64)
    noise *= setting.measurement_sd
    if (error := setting.sensor_error) is not None:
        noise += error.drawn(batch, samples - 1, dt, generator) @ error.mixing(width)
    measurements = torch.full_like(noise, torch.nan)
    for k in (k for k in setting.updates if k < samples):
        measurements[:, k - 1] = observe(setting.measurement, truth[:, k], k * dt) + noise[:, k - 1]
    return measurements


def perturbed_arcs(
    setting: Setting,
    truth: Tensor,
    dt: float,
    count: int,
    steps: int | None,
    seed: int,
    controls: Tensor | None = None,
    *,
    linear: bool = False,
) -> Problem:
    """Return arcs of trajectories with perturbed starts, to choose an estimator's constants on.

    Args:
        setting: measurements and P0.
        truth: (N, T + 1, D) trajectories, NaN where one has ended.
        dt: length of a step.
        count: number of arcs, each from a trajectory of its own.
        steps: length of an arc; arcs that are shorter than their trajectories begin evenly spread over them,
            so that all phases of a motion take part. None takes whole trajectories.
        seed: of the initial errors and the measurements.
        controls: (N, T + 1, m) of the trajectories; None where nothing is controlled.
        linear: whether these are interpolated linearly between samples.
    """
    chosen = torch.linspace(0, len(truth) - 1, count).long()
    states = truth[chosen]
    whole = states.shape[1] - 1
    steps = whole if steps is None else min(steps, whole)
    shortest = int(truth.isfinite().all(-1).sum(-1).min()) - 1
    begin = torch.linspace(0, max(0, shortest - steps), count).long()
    samples = torch.arange(count)[:, None], begin[:, None] + torch.arange(steps + 1)
    arcs, controls = states[samples], None if controls is None else controls[chosen][samples]
    generator = torch.Generator().manual_seed(seed)
    noise = torch.randn(arcs[:, 0].shape, generator=generator, dtype=torch.float64)
    measurements = simulated(setting, arcs, dt, seed + 1)
    starts = arcs[:, 0] + noise * setting.start_sd
    return Problem(arcs, starts, measurements, dt, controls, linear)
