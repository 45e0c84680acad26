"""Simulated sensor of training data: noisy measurements instead of states."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import torch
from torch import Tensor

from ahnn.arguments import Count, Positive, Seed, Within, checked
from ahnn.errors import UserError
from ahnn.measurements import (
    Biases,
    Instrument,
    Locating,
    Observations,
    State,
    UnknownNoise,
    noise_deviations,
    observe,
    reading,
)
from ahnn.memory import require_memory
from ahnn.types import Space, Trajectories

Share = Annotated[float, Within(0, 0.9)]
OUTLIER = 50.0
"""Size of an outlier, in standard deviations."""
COPIES = 4
"""Number of copies of the measurements in memory while they are drawn."""


@checked
class Sensor:
    """Sensor with its sampling, gaps and outliers.

    Args:
        space: description of the state components.
        measured: `state`, `position`, or a measurement model.
        noise: standard deviations in measurement units: a common number, one for positions and one for
            momenta, one per component, or the noise of one of several stations. For recorded measurements
            also `estimate`: they are estimated in training.
        every: number of trajectory samples between measurements.
        stride: maximum integrator step, in trajectory samples; a step ends at each measurement. 0.25 takes
            at least four steps per sample.
        gaps: fraction of randomly missing measurements.
        outliers: fraction of measured values with an error of 50 standard deviations.
        bias_sd: standard deviations of constant biases, in the format of `Biases.of`. Biases are drawn with
            these deviations and estimated in training. None: no biases.
        correlation: whether the training estimates how noise correlates in time.
        tails: whether the training estimates scale and degrees of freedom of Student's noise.
        freedom: degrees of freedom of the simulated noise, with `noise` as its scale; None for normal noise.
        seed: seed of all random draws.

    Raises:
        UserError: standard deviations that do not fit the measurements, or a model from which positions
            cannot be estimated.
    """

    draws: ClassVar[bool] = True

    def __init__(
        self,
        space: Space,
        *,
        measured: Literal["state", "position"] | Any,
        noise: float | list[float] | Literal["estimate"],
        every: Count = 1,
        stride: Positive = 1,
        gaps: Share = 0.0,
        outliers: Share = 0.0,
        bias_sd: float | list[float] | None = None,
        correlation: Literal["estimate"] | None = None,
        tails: Literal["estimate"] | None = None,
        freedom: Positive | None = None,
        seed: Seed = 0,
    ) -> None:
        self.space = space
        try:
            self.measurement: Any = reading(measured, space) if isinstance(measured, str) else measured
        except ValueError as error:
            message = f"data.measured: {error}"
            raise UserError(message) from error
        if not isinstance(self.measurement, Locating):
            message = (
                "data.measured: expected state, position, or a model with a method `locate`, which gives "
                f"initial guesses; received {type(self.measurement).__name__}"
            )
            raise UserError(message)
        measured_by: Any = self.measurement
        sizes = noise == "estimate"
        if sizes and self.draws:
            message = (
                "data.noise: expected standard deviations of simulated noise; received estimate, which "
                "requires recorded measurements: sensor=recorded"
            )
            raise UserError(message)
        stated = 1.0 if isinstance(noise, str) else noise  # replaced by estimates from sample differences
        self.deviations = noise_deviations(measured_by, stated, "data.noise")
        biases = Biases.of(measured_by, bias_sd, None, "data.")
        prior = None if biases is None else torch.tensor(biases.deviations, dtype=torch.float64)
        self.unknown = UnknownNoise(sizes, correlation is not None, prior, tails is not None)
        if tails is not None and correlation is not None:
            message = (
                "data.tails: expected data.correlation=null; received data.correlation=estimate. Leave one "
                "of them out"
            )
            raise UserError(message)
        self.freedom = freedom
        self.every, self.stride, self.gaps, self.outliers, self.seed = every, stride, gaps, outliers, seed

    @property
    def gives_states(self) -> bool:
        """Whether complete states are measured."""
        return isinstance(self.measurement, State)

    def instrument(self, spacing: float) -> Instrument:
        """Return the instrument, as needed by fits, for measurements of samples at a given spacing."""
        longest, space = self.stride * spacing, self.space
        return Instrument(self.measurement, self.deviations, longest, space.dof, space.factor)

    def measure(self, truth: Trajectories, part: int) -> Observations:
        """Simulate measurements (B, K, M) of true trajectories, with a seed per part of the data."""
        states, times = truth.states[:, :: self.every], truth.times[:, :: self.every]
        size = COPIES * 8.0 * times.numel() * len(self.measurement.names)
        require_memory("data.trajectories, system.steps", "measurements", size)
        values = observe(self.measurement, states, times)
        generator = torch.Generator().manual_seed((self.seed * 1_000_003 + part) % 2**63)
        draw: dict[str, Any] = {"generator": generator, "dtype": torch.float64}
        noise = torch.randn(values.shape, **draw) * self.deviations
        values = values + noise * self._tail_factors(values, part)
        if self.unknown.bias_sd is not None:
            own = torch.Generator().manual_seed(self.seed)  # the same bias in all splits
            shape = self.unknown.bias_sd.shape
            values = values + self.unknown.bias_sd * torch.randn(shape, generator=own, dtype=torch.float64)
        off = torch.rand(values.shape, **draw) < self.outliers
        sign = torch.where(torch.rand(values.shape, **draw) < 0.5, -1.0, 1.0)
        values = torch.where(off, values + OUTLIER * sign * self.deviations, values)
        missing = torch.rand(values.shape[:2], **draw) < self.gaps
        return Observations(values.masked_fill(missing.unsqueeze(-1), torch.nan), times)

    def _tail_factors(self, values: Tensor, part: int) -> Tensor | float:
        """Return the factors that turn normal noise into Student's noise, in the shape of the values."""
        if self.freedom is None:
            return 1.0
        draw = np.random.default_rng((self.seed, part))
        return torch.from_numpy((self.freedom / draw.chisquare(self.freedom, tuple(values.shape))) ** 0.5)
