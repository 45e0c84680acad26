"""Sensor that supplies recorded measurements instead of simulating them."""

from __future__ import annotations

from ahnn.data.sensor import Sensor
from ahnn.measurements import Observations, continuous, periods
from ahnn.types import Trajectories


class Recorded(Sensor):
    """Sensor of recorded measurements, with values from the file and without simulated noise.

    The true states are unknown, also in the test split.
    """

    draws = False

    def measure(self, truth: Trajectories, part: int) -> Observations:
        """Return the recorded values (B, T, M), NaN where missing; angles are unwrapped."""
        values = self.measurement(truth.states, truth.times)
        return Observations(continuous(values, periods(self.measurement)), truth.times)
