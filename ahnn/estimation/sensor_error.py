"""Sensor errors as filter states: constant biases, or biases with a correlation time.

Each error b is added to one measured component, and is a first-order Gauss-Markov process (Tapley, Schutz &
Born 2004, section 4.9; constant biases as in section 6.3):

    b' = exp(-dt / memory) b + w,   w ~ N(0, sd² (1 - exp(-2 dt / memory))),

with stationary variance sd². Infinite memory gives a constant bias, finite memory coloured noise. Estimators
receive augmented states, flow and process noise, and need no modification.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ahnn.dynamics.flow_at_time import wrapped
from ahnn.estimation.belief import Belief
from ahnn.estimation.covariances import Factor
from ahnn.estimation.process_model import Process, factored
from ahnn.measurements import Biases, DerivedMeasurement, Measurement, Time
from ahnn.types import Flow, TimeStep

LENGTHS = 1000
"""Number of step lengths whose factors are cached."""


class SensorError(NamedTuple):
    """K sensor errors; augmented states are (x, b), shape (..., D + K).

    Attributes:
        deviations: (K,) prior standard deviations, in the units of the measurements.
        memories: (K,) time constants, in the unit of the flow; inf for a constant bias.
        places: index of the error for each of the M components of each sensor; None without error.
    """

    deviations: Tensor
    memories: Tensor
    places: Mapping[str, Sequence[int | None]]

    @classmethod
    def of(cls, sensors: Mapping[str, Biases | None]) -> SensorError | None:
        """Collect the errors of sensors, in the order of their names; None without errors."""
        deviations, memories, places = list[float](), list[float](), dict[str, list[int | None]]()
        for name, biases in sorted(sensors.items()):
            if biases is None:
                continue
            places[name] = []
            for sd, memory in zip(biases.deviations, biases.memories, strict=True):
                places[name].append(len(deviations) if sd > 0.0 else None)
                if sd > 0.0:
                    deviations.append(sd)
                    memories.append(memory)
        if not deviations:
            return None
        sds, times = (torch.tensor(part, dtype=torch.float64) for part in (deviations, memories))
        return cls(sds, times, places)

    @property
    def added(self) -> int:
        """Number of errors K."""
        return len(self.deviations)

    @property
    def about(self) -> list[list[float]]:
        """Plain numbers that identify the error model."""
        return [self.deviations.tolist(), self.memories.tolist()]

    def belief(self, belief: Belief) -> Belief:
        """Return the augmented belief, with errors independent of the state."""
        mean, chol = belief
        both, size = pad(chol, (0, self.added, 0, self.added)), mean.shape[-1]
        both[:, size:, size:] = self.deviations.to(mean).diag()
        return Belief(pad(mean, (0, self.added)), both)

    def flow(self, flow: Flow) -> Flow:
        """Return the flow of augmented states."""
        return wrapped(flow, self._augmented)

    def _augmented(self, flow: Flow) -> Flow:
        def augmented(x: Tensor, dt: TimeStep) -> Tensor:
            state, errors = x[..., : -self.added], x[..., -self.added :]
            step = dt.unsqueeze(-1) if isinstance(dt, Tensor) else dt
            return torch.cat((flow(state, dt), self._kept(step).to(errors) * errors), dim=-1)

        return augmented

    def process_noise(self, additive: Tensor, dt: float) -> Tensor:
        """Return Q of augmented states for one step, from Q of the other components, (D, D) or (B, D, D)."""
        both, size = pad(additive, (0, self.added, 0, self.added)), additive.shape[-1]
        both[..., size:, size:] = self._kick(dt).square().diag()
        return both

    def measurement(self, measurement: Measurement, sensor: str = "") -> Measurement:
        """Return the measurement model of augmented states from a model of the other components."""
        mixing = self.mixing(len(measurement.names), sensor)

        def biased(x: Tensor, t: Time) -> Tensor:
            state, errors = x.split((x.shape[-1] - self.added, self.added), dim=-1)
            return measurement(state, t) + errors @ mixing.to(x)

        return DerivedMeasurement(measurement, biased)

    def mixing(self, size: int, sensor: str = "") -> Tensor:
        """Return the matrix (K, M) that maps row vectors of errors to the M components of a sensor."""
        matrix = torch.zeros(self.added, size, dtype=torch.float64)
        for component, place in enumerate(self.places.get(sensor, ())):
            if place is not None:
                matrix[place, component] = 1.0
        return matrix

    def process(self, process: Process) -> Process:
        """Return the online process of augmented states; sensor models are augmented individually."""

        def lifted(belief: Belief) -> Belief:
            return self.belief(process.lifted(belief))

        @lru_cache(LENGTHS)
        def noise(dt: float) -> Factor:
            return Factor(torch.block_diag(factored(process.noise(dt)), self._kick(dt).diag()))

        about = {**process.about, "sensor_error": [*self.about, self.places]}
        return process._replace(flow=self.flow(process.flow), noise=noise, lifted=lifted, about=about)

    def drawn(self, batch: int, steps: int, dt: float, generator: torch.Generator) -> Tensor:
        """Draw errors (B, T, K) at the ends of T steps, from their stationary distribution."""
        draws = torch.randn(batch, steps, self.added, generator=generator, dtype=torch.float64)
        errors = [self.deviations * draws[:, 0]]
        for draw in draws[:, 1:].unbind(1):
            errors.append(self._kept(dt) * errors[-1] + self._kick(dt) * draw)
        return torch.stack(errors, dim=1)

    def _kept(self, dt: TimeStep) -> Tensor:
        """Return the fractions of the errors that remain after a step."""
        return torch.exp(-torch.as_tensor(dt, dtype=torch.float64) / self.memories)

    def _kick(self, dt: float) -> Tensor:
        """Return the standard deviations (K,) of the error increments of a step."""
        return self.deviations * (-torch.expm1(-2.0 * dt / self.memories)).sqrt()
