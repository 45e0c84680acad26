"""Measurements that a file holds, in the place of simulated ones."""

from __future__ import annotations

from ahnn.data.sensor import Sensor
from ahnn.measurements import Observations, continuous, periods
from ahnn.types import Trajectories


class Recorded(Sensor):
    """The instrument of recorded measurements: its values are those of the file, and nothing is drawn.

    The truth is not known, of test trajectories neither.
    """

    draws = False

    def measure(self, truth: Trajectories, part: int) -> Observations:
        """Return the recorded values (B, T, M), NaN where one is missing; angles go on over turns."""
        del part
        values = self.measurement(truth.states, truth.times)
        return Observations(continuous(values, periods(self.measurement)), truth.times)
