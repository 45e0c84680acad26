"""Reading of an instrument at one time."""

from __future__ import annotations

import math
from typing import NamedTuple


class Reading(NamedTuple):
    """Reading of one sensor.

    Attributes:
        time: time in the unit of the space.
        values: M measured values, NaN where missing.
        sensor: sensor name; "" for a single sensor.
        deviations: M standard deviations; None: as set for the sensor.
        controls: m values valid from this time, None for an unchanged one; () for no change.

    A reading without values belongs to no sensor: it changes controls, or requests a prediction.
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
        """Build the reading from lists."""
        own = None if deviations is None else tuple(deviations)
        return cls(time, tuple(values), sensor, own, tuple(controls))

    @property
    def is_empty(self) -> bool:
        """Whether nothing was measured."""
        return all(map(math.isnan, self.values))
