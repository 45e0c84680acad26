"""Sensors of a stream."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from ahnn.estimation import Factor
from ahnn.measurements import Biases, Measurement, Position, State, noise_deviations
from ahnn.types import Space


class StreamSensor(NamedTuple):
    """Sensor of a stream.

    Attributes:
        measurement: measurement model.
        deviations: standard deviations of its M values; None if each reading supplies its own.
        columns: column names of its M values in a stream.
        biases: biases estimated with the state, or None.
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
        """Build a sensor; if it measures state components, their names are its columns.

        Args:
            measurement: measurement model.
            deviations: standard deviations, as for `noise_deviations`; None if each reading supplies its own.
            space: description of the state components.
            bias_sd: standard deviations of estimated biases, as for `Biases.of`.
            bias_memory: time constants of the biases.

        Raises:
            UserError: in the same cases as `noise_deviations` and `Biases.of`.
        """
        reads = isinstance(measurement, Position | State)
        columns = space.components[: len(measurement.names)] if reads else measurement.names
        biases = Biases.of(measurement, bias_sd, bias_memory)
        if deviations is None:
            return cls(measurement, None, columns, biases)
        own = noise_deviations(measurement, deviations, "sd").tolist()
        return cls(measurement, tuple(own), columns, biases)

    def factor(self, deviations: tuple[float, ...] | None) -> Factor:
        """Return the factor of R of a reading; its own standard deviations take precedence."""
        return Factor(torch.diag(torch.tensor(deviations or self.deviations, dtype=torch.float64)))


def plain(thing: Any) -> Any:
    """Return the defining properties of an object as plain values: its class and `about`, or attributes."""
    if thing is None or isinstance(thing, bool | int | float | str):
        return thing
    if isinstance(thing, list | tuple):
        return [plain(one) for one in thing]
    if isinstance(thing, Tensor):
        return thing.tolist()
    about = getattr(thing, "about", None)
    held = thing if isinstance(thing, dict) else about or getattr(thing, "__dict__", {})
    return [type(thing).__name__, {str(name): plain(value) for name, value in held.items()}]
