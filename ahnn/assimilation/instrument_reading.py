"""What an instrument said at a time."""

from __future__ import annotations

import math
from typing import NamedTuple


class Reading(NamedTuple):
    """What an instrument said.

    Attributes:
        time: in the unit of the space.
        values: M numbers, NaN where one is missing.
        sensor: its name; "" where there is one sensor.
        deviations: M standard deviations; None takes those of the sensor.
        controls: m numbers that hold from its time on, None for one that stays as it is; () changes none.

    One without values is of no sensor: it changes controls, or asks for a prediction.
    """

    time: float
    values: tuple[float, ...] = ()
    sensor: str = ""
    deviations: tuple[float, ...] | None = None
    controls: tuple[float | None, ...] = ()

    @classmethod
    def of_plain(
        cls,
        time: float,
        values: list[float],
        sensor: str,
        deviations: list[float] | None,
        controls: list[float | None],
    ) -> Reading:
        """Return the reading whose parts are lists."""
        own = None if deviations is None else tuple(deviations)
        return cls(time, tuple(values), sensor, own, tuple(controls))

    @property
    def is_empty(self) -> bool:
        """Whether nothing was measured."""
        return all(map(math.isnan, self.values))

    @property
    def label(self) -> str:
        """Its time, and which sensor it is of."""
        return f"time {self.time:g}" + (f" of sensor {self.sensor}" if self.sensor else "")
