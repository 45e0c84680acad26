"""The instruments of a stream."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from ahnn.estimation import Factor
from ahnn.measurements import Biases, Measurement, Position, State, noise_deviations
from ahnn.types import Space


class StreamSensor(NamedTuple):
    """An instrument of a stream.

    Attributes:
        measurement: its model.
        deviations: standard deviations of its M numbers; None where each reading brings its own.
        columns: names of its M numbers in a stream.
        biases: that are estimated with the state; None for none.
    """

    measurement: Measurement
    deviations: tuple[float, ...] | None
    columns: tuple[str, ...]
    biases: Biases | None = None

    @classmethod
    def of(
        cls,
        measurement: Measurement,
        deviations: float | list[float] | None,
        space: Space,
        *,
        bias_sd: float | list[float] | None = None,
        bias_memory: float | list[float] | None = None,
    ) -> StreamSensor:
        """Return the sensor of a model; one that reads the state has the names of the space as columns.

        Args:
            measurement: the model.
            deviations: as `noise_deviations` takes them, or None.
            space: what the numbers of a state mean.
            bias_sd: standard deviations of biases, which are estimated, as `Biases.of` takes them.
            bias_memory: their time constants.

        Raises:
            UserError: what `noise_deviations` and `Biases.of` refuse.
        """
        reads = isinstance(measurement, Position | State)
        columns = space.components[: len(measurement.names)] if reads else measurement.names
        biases = Biases.of(measurement, bias_sd, bias_memory)
        if deviations is None:
            return cls(measurement, None, columns, biases)
        own = noise_deviations(measurement, deviations, "sd").tolist()
        return cls(measurement, tuple(own), columns, biases)

    def factor(self, deviations: tuple[float, ...] | None) -> Factor:
        """Return the factor of R of a reading, whose own standard deviations come first."""
        return Factor(torch.diag(torch.tensor(deviations or self.deviations, dtype=torch.float64)))


def plain(thing: Any) -> Any:
    """Return what determines an object, as plain values: its class and its `about`, or all that it holds."""
    if thing is None or isinstance(thing, bool | int | float | str):
        return thing
    if isinstance(thing, list | tuple):
        return [plain(one) for one in thing]
    if isinstance(thing, Tensor):
        return thing.tolist()
    about = getattr(thing, "about", None)
    held = thing if isinstance(thing, dict) else about or getattr(thing, "__dict__", {})
    return [type(thing).__name__, {str(name): plain(value) for name, value in held.items()}]
