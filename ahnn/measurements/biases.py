"""Prior of sensor biases from user input."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from ahnn.errors import UserError
from ahnn.measurements.base import Measurement
from ahnn.measurements.noise import for_each_component


class Biases(NamedTuple):
    """Biases of the M measured components of a sensor; see `ahnn.estimation.sensor_error`.

    Attributes:
        deviations: (M,) standard deviations, 0 for a component without bias.
        memories: (M,) time constants, in the unit of time; inf for a constant bias.
    """

    deviations: tuple[float, ...]
    memories: tuple[float, ...]

    @classmethod
    def of(
        cls,
        measurement: Measurement,
        deviations: float | Sequence[float] | None,
        memory: float | Sequence[float] | None,
        who: str = "",
    ) -> Biases | None:
        """Build the biases of a sensor; None if there are none.

        Args:
            measurement: measurement model with M components.
            deviations: one number for all components, one for each, or as in `noise_deviations`; 0 for a
                component without bias; None: no biases.
            memory: time constants, in the same format; None: constant biases.
            who: prefix of keys in messages.

        Raises:
            UserError: wrong count, number out of range, or a memory without biases.
        """
        names = measurement.names
        if deviations is None:
            if memory is not None:
                message = f"{who}bias_memory: expected {who}bias_sd with {memory}; received none"
                raise UserError(message)
            return None
        sds = for_each_component(measurement, numbers_of(deviations))
        if len(sds) != len(names) or not all(0.0 <= sd < 1e150 for sd in sds) or not any(sds):
            message = (
                f"{who}bias_sd: expected standard deviations of biases, one for all or one for each of "
                f"{', '.join(names)}, 0 where there is none, not all 0, below 1e150; received {deviations}"
            )
            raise UserError(message)
        times = for_each_component(measurement, [math.inf] if memory is None else numbers_of(memory))
        if len(times) != len(names) or not all(time > 0.0 for time in times):
            message = (
                f"{who}bias_memory: expected times > 0, one for all or one for each of {', '.join(names)}; "
                f"received {memory}"
            )
            raise UserError(message)
        return cls(tuple(sds), tuple(times))


def numbers_of(given: Any) -> list[Any]:
    """Return one number or a list of them as a list; empty for other values."""
    values = [*given] if isinstance(given, Sequence) and not isinstance(given, str | bytes) else [given]
    plain = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    return values if plain else []
