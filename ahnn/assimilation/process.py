"""What an estimator is told of a motion and of the instruments that see it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ahnn.deviations import require_squares
from ahnn.errors import UserError
from ahnn.estimation import Belief, Covariance, Factor, FilterState, Recursive
from ahnn.measurements import Measurement, Position, State
from ahnn.substeps import substeps
from ahnn.types import Flow, Space


def same(value: Any) -> Any:
    """Return what is given."""
    return value


class Process(NamedTuple):
    """An estimator with its process model.

    Attributes:
        estimator: it predicts and updates.
        flow: the process model.
        noise: Q of a step, as a function of its length.
        max_step: longest step of the flow; longer gaps are cut into equal ones.
        lifted: from a belief about the state to one about all that is estimated, the state first.
        seen: from a measurement model of the state to one of all that is estimated.
        about: plain values that say what this is.
    """

    estimator: Recursive[FilterState]
    flow: Flow
    noise: Callable[[float], Covariance]
    max_step: float
    lifted: Callable[[Belief], Belief] = same
    seen: Callable[[Measurement], Measurement] = same
    about: dict[str, Any] = {}  # noqa: RUF012 - never written to

    def advanced(self, state: FilterState, since: float, time: float) -> FilterState:
        """Return the state of the time `since` at a later one."""
        gap = time - since
        if not gap > 0.0:
            return state
        count = substeps(gap, self.max_step)
        length = gap / count
        for _ in range(count):
            state = self.estimator.predict(state, self.flow, length, self.noise(length))
        return state._replace(time=torch.tensor(time, dtype=torch.float64))


class Sensor(NamedTuple):
    """An instrument of a stream.

    Attributes:
        measurement: its model.
        deviations: standard deviations of its M numbers; None where each reading brings its own.
        columns: names of its M numbers in a stream.
    """

    measurement: Measurement
    deviations: tuple[float, ...] | None
    columns: tuple[str, ...]

    @classmethod
    def of(cls, measurement: Measurement, deviations: float | list[float] | None, space: Space) -> Sensor:
        """Return the sensor of a model; one that reads the state has the names of the space as columns.

        Args:
            measurement: the model.
            deviations: one for all M numbers, one for each, or None.
            space: what the numbers of a state mean.

        Raises:
            UserError: another number of deviations, or one that is not positive.
        """
        reads = isinstance(measurement, Position | State)
        columns = space.components[: len(measurement.names)] if reads else measurement.names
        if deviations is None:
            return cls(measurement, None, columns)
        given = deviations if isinstance(deviations, list | tuple) else [deviations] * len(columns)
        if len(given) != len(columns) or not all(0.0 < sd < math.inf for sd in given):
            message = f"sd: expected one number > 0 for each of {', '.join(columns)}; received {deviations}"
            raise UserError(message)
        require_squares(torch.tensor(given, dtype=torch.float64), "sd")
        return cls(measurement, tuple(map(float, given)), columns)

    def factor(self, deviations: tuple[float, ...] | None) -> Factor:
        """Return the factor of R of a reading, whose own standard deviations come first."""
        return Factor(torch.diag(torch.tensor(deviations or self.deviations, dtype=torch.float64)))


def plain(thing: Any) -> Any:
    """Return what determines an object, as plain values: its class and all that it holds."""
    if thing is None or isinstance(thing, bool | int | float | str):
        return thing
    if isinstance(thing, list | tuple):
        return [plain(one) for one in thing]
    if isinstance(thing, Tensor):
        return thing.tolist()
    held = thing if isinstance(thing, dict) else getattr(thing, "__dict__", {})
    return [type(thing).__name__, {str(name): plain(value) for name, value in held.items()}]
