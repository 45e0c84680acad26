"""Mistakes in units: factors of 1000 in rejected measurements, and elevations above a right angle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import median

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

KEPT = 200
"""Maximum number of ratios kept for each measured value."""
LEAST = 3
"""Number of ratios below which nothing is said."""
NEAR = 0.1
"""Tolerance of the decimal logarithm of a ratio."""
FACTORS = {3: "1000", -3: "1/1000"}
"""Suspicious ratios by their decimal logarithms."""

ELEVATION, AZIMUTH = "elevation", "azimuth"
"""Suffixes of the names of these angles."""


def steep_elevation(name: str, value: float, unit: str, scale: float) -> str:
    """Return the message on an elevation above a right angle.

    Args:
        name: name of the column, which ends with `ELEVATION`.
        value: value in rad.
        unit: unit of the column.
        scale: this unit in rad.
    """
    message = f"{name}: expected at most "
    if scale == 1.0:
        remedy = f"If the values are in degrees, name the column {name} [deg]"
        return f"{message}pi/2 rad; received {value:g}. {remedy}"
    other = name.removesuffix(ELEVATION) + AZIMUTH
    received = f"{math.pi / 2 / scale:g} {unit}; received {value / scale:g} {unit}"
    return f"{message}{received}. The columns {other} and {name} may be exchanged"


def in_wrong_unit(measured: Tensor, predicted: Tensor) -> Tensor:
    """Return whether readings (B, M) are predictions with some components times 1000 or 1/1000, (B,) bool.

    These are most of the components, or all that are not as predicted. Missing components are NaN.
    """
    missing, power = measured.isnan(), (measured / predicted).abs().log10()
    wrong = torch.stack([(power - factor).abs() < NEAR for factor in FACTORS]).any(0)
    most = 2 * wrong.sum(-1) > (~missing).sum(-1)
    return most | (wrong.any(-1) & (wrong | missing | (power.abs() < NEAR)).all(-1))


class RejectedRatios:
    """Ratios of rejected measurements to their predictions, by sensor and measured value."""

    def __init__(self) -> None:
        self.known: dict[tuple[str, str], list[float]] = {}
        self.closed: set[str] = set()

    def add(self, sensor: str, names: Sequence[str], values: ArrayLike, residuals: ArrayLike) -> None:
        """Add rejected measurements.

        Args:
            sensor: name of the sensor.
            names: names of its M values.
            values: (..., M) measured values, NaN where missing.
            residuals: (..., M) measurements minus predictions.
        """
        if sensor in self.closed:
            return
        measured = np.asarray(values, dtype=np.float64).reshape(-1, len(names))
        predicted = measured - np.asarray(residuals, dtype=np.float64).reshape(-1, len(names))
        with np.errstate(divide="ignore", invalid="ignore"):
            ratios = np.log10(np.abs(measured / predicted))
        for name, column in zip(names, ratios.T, strict=True):
            own = self.known.setdefault((sensor, name), [])
            own += column[np.isfinite(column)][: KEPT - len(own)].tolist()

    def close(self, sensor: str) -> None:
        """Ignore later measurements of a sensor, whose reopened gate has moved the predictions to them."""
        if any(whose == sensor and len(ratios) >= LEAST for (whose, _), ratios in self.known.items()):
            self.closed.add(sensor)

    def update(self, other: RejectedRatios) -> None:
        """Add the ratios of another stream."""
        for key, ratios in other.known.items():
            self.known.setdefault(key, []).extend(ratios)

    def sentence(self, sensor: str | None = None) -> str:
        """Return a remark on the values of a sensor, or of all of them for None; "" without suspicion."""
        found: dict[str, dict[str, None]] = {}
        for (whose, name), ratios in self.known.items():
            middle = median(ratios) if len(ratios) >= LEAST else math.nan
            near = [text for power, text in FACTORS.items() if abs(middle - power) < NEAR]
            if near and sensor in (None, whose):
                found.setdefault(near[0], {})[name] = None
        return "; ".join(
            f"the measured {', '.join(names)} {'is' if len(names) == 1 else 'are'} about {factor} times the "
            f"predicted value{'s' * (len(names) > 1)}: is the unit right?"
            for factor, names in found.items()
        )
