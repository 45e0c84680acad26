"""Standard deviations of measurement noise from user input."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from ahnn.deviations import require_squares
from ahnn.errors import UserError
from ahnn.measurements.base import Measurement
from ahnn.measurements.readings import State
from ahnn.measurements.several import Several


def noise_deviations(
    measurement: Measurement,
    given: float | Sequence[float] | None,
    who: str,
) -> Tensor:
    """Expand standard deviations to the M components of a measurement, (M,).

    Args:
        measurement: the model, with M components.
        given: one number for all components, or one for each; for states also one for positions and one for
            momenta; for several instruments of equal size, the values for one of them. None: the model's
            `deviations`, which must then exist.
        who: the parameter, for messages.

    Raises:
        UserError: wrong count, or numbers that are not positive and finite.
    """
    values, states = for_each_component(measurement, given), isinstance(measurement, State)
    if len(values) == len(measurement.names) and all(0.0 < v < math.inf for v in values):
        return require_squares(torch.tensor(values, dtype=torch.float64), who)
    names = ", ".join(f"{n} [{u}]" for n, u in zip(measurement.names, measurement.units, strict=True))
    message = (
        f"{who}: expected a standard deviation > 0 for each of {names}"
        f"{', or one for each block,' if states else ''} or one for all; received {given}"
    )
    raise UserError(message)


def for_each_component(measurement: Measurement, given: float | Sequence[float] | None) -> list[float]:
    """Expand numbers to one per component as in `noise_deviations`; lists of other lengths are unchanged."""
    size, states = len(measurement.names), isinstance(measurement, State)
    given = getattr(measurement, "deviations", None) if given is None else given
    values = [*given] if isinstance(given, Sequence) else [] if given is None else [given]
    if states and len(values) == 2:
        values = [v for v in values for _ in range(size // 2)]
    alike = isinstance(measurement, Several) and {*measurement.sizes} == {len(values)}
    return values * (size // len(values)) if alike or len(values) == 1 else values
