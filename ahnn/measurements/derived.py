"""Measurement models derived from others, for example for augmented states."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from torch import Tensor

from ahnn.measurements.angles import periods, residual
from ahnn.measurements.base import Measurement, Time


class DerivedMeasurement:
    """Measurement model with the components and residuals of another, and its own function of the states.

    Args:
        model: measurement model that defines the M components and their residuals.
        function: states (..., D) and time -> measurements (..., M).
    """

    def __init__(self, model: Measurement, function: Callable[[Tensor, Time], Tensor]) -> None:
        self.names, self.units, self.periods = model.names, model.units, periods(model)
        self.residual, self._function = partial(residual, model), function

    def __call__(self, x: Tensor, t: Time) -> Tensor:
        """Return the measurements (..., M) of the states x (..., D) at time t."""
        return self._function(x, t)
