"""What is believed of the biases of a sensor, as people say it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from ahnn.errors import UserError
from ahnn.measurements.base import Measurement
from ahnn.measurements.noise import for_each_component


class Biases(NamedTuple):
    """Biases of the M components of what a sensor measures; see `ahnn.estimation.sensor_error`.

    Attributes:
        deviations: (M,) standard deviations, 0 of a component without bias.
        memories: (M,) time constants, in the unit of time; inf for a bias that is constant.
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
        """Return the biases of a sensor, None where it has none.

        Args:
            measurement: the model, with M components.
            deviations: one number for all components, one for each, or as `noise_deviations` takes them;
                0 where there is no bias; None for none.
            memory: time constants, likewise; None for constant biases.
            who: what stands before the keys in messages.

        Raises:
            UserError: another count, numbers of the wrong sign, or a memory of no bias.
        """
        names = measurement.names
        if deviations is None:
            if memory is not None:
                message = f"{who}bias_memory: expected {who}bias_sd with it; received {memory} alone"
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
    """Return one number or a list of them as a list; empty where they are none."""
    values = [*given] if isinstance(given, Sequence) and not isinstance(given, str | bytes) else [given]
    plain = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    return values if plain else []
