"""Evaluation scenarios of estimators: trajectories, noisy measurements, uncertain initial states."""

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
"""Offset added to the seed for measurement noise, which must differ from the seed for initial errors."""


class Setting(NamedTuple):
    """Measurement and initial uncertainty settings, common to all models and estimators.

    Attributes:
        measurement: measurement model.
        measurement_sd: (M,) standard deviations of both the simulated noise and R.
        start_sd: (D,) standard deviations of the initial error; P0 is diagonal.
        updates: increasing indices of measured samples, at least 1.
        sensor_error: biases of the measurements, simulated and estimated; None: no biases.
    """

    measurement: Measurement
    measurement_sd: Tensor
    start_sd: Tensor
    updates: tuple[int, ...]
    sensor_error: SensorError | None = None

    @property
    def measurement_noise(self) -> Tensor:
        """Covariance R, (M, M)."""
        return torch.diag(self.measurement_sd**2)

    @property
    def start_covariance(self) -> Tensor:
        """Covariance P0, (D, D)."""
        return torch.diag(self.start_sd**2)

    @property
    def first(self) -> int:
        """Index of the first measured sample."""
        return self.updates[0]


class Problem(NamedTuple):
    """Trajectories to estimate.

    Attributes:
        truth: (B, T + 1, D), NaN after the end of a trajectory.
        starts: (B, D) initial estimates at time zero.
        measurements: (B, T, M), NaN where missing.
        dt: step length.
        controls: (B, T + 1, m) known controls; None without controls.
        linear: whether controls are interpolated linearly between samples, instead of held constant.
    """

    truth: Tensor
    starts: Tensor
    measurements: Tensor
    dt: float
    controls: Tensor | None = None
    linear: bool = False

    def repeated(self, count: int) -> Problem:
        """Return `count` copies of the problem, with member b of copy i in row i B + b."""
        parts = self.truth, self.starts, self.measurements, self.controls
        rows = (None if part is None else part.repeat(count, *[1] * (part.ndim - 1)) for part in parts)
        return self._replace(**dict(zip(("truth", "starts", "measurements", "controls"), rows, strict=True)))

    def driven(self, flow: Flow) -> Flow:
        """Bind a process model to the controls; a model without controls is returned unchanged."""
        if self.controls is None or clock_of(flow) < 2:
            return flow
        times = self.dt * torch.arange(self.controls.shape[1], dtype=torch.float64)
        return steered(flow, times, self.controls.nan_to_num(), linear=self.linear)


def simulated(setting: Setting, truth: Tensor, dt: float, seed: int) -> Tensor:
    """Simulate noisy measurements (B, T, M) of true trajectories (B, T + 1, D).

    Values are NaN between measurements, and where a state is outside the sensor's field of view.
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
    """Cut arcs from trajectories and perturb their initial states, for the tuning of estimators.

    Args:
        setting: measurement settings and P0.
        truth: (N, T + 1, D) trajectories, NaN after the end of a trajectory.
        dt: step length.
        count: number of arcs, each from a different trajectory.
        steps: length of an arc. Arcs shorter than their trajectory begin at evenly spaced times, so that all
            phases of the motion are covered. None: full trajectories.
        seed: random seed for initial errors and measurement noise.
        controls: (N, T + 1, m) controls of the trajectories; None without controls.
        linear: whether controls are interpolated linearly between samples.
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
