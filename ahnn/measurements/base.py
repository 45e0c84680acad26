"""What a measurement model is, and the two that read the state itself.

A model is any object with the members of `Measurement`: one class, and one YAML file that names it.
"""

from __future__ import annotations

import math
from typing import Protocol

import torch
from torch import Tensor


class Measurement(Protocol):
    """Map of states to measurements, and what their difference means.

    Attributes:
        names: of the M components.
        units: of the M components.
    """

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the M components."""
        ...

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the M components."""
        ...

    def __call__(self, x: Tensor, t: float) -> Tensor:
        """Return the measurements (..., M) of the states x (..., D) at time t."""
        ...

    def residual(self, y: Tensor, y_pred: Tensor) -> Tensor:
        """Return y - y_pred, shape (..., M), with angles wrapped to (-pi, pi]."""
        ...


def wrap(angle: Tensor) -> Tensor:
    """Return the angle in (-pi, pi]; an angle that is already there is returned as it is, bit for bit."""
    turned = angle - 2.0 * math.pi * torch.round(angle / (2.0 * math.pi))
    # Rounding may have put it just outside.
    turned = torch.where(turned > math.pi, turned - 2.0 * math.pi, turned)
    return torch.where(turned <= -math.pi, turned + 2.0 * math.pi, turned)


class Position:
    """The first n of 2 n state components: the positions q, as in the paper.

    Args:
        degrees_of_freedom: n.
        unit: of a position.
    """

    def __init__(self, degrees_of_freedom: int = 3, unit: str = "km") -> None:
        self.names = tuple(f"q{i + 1}" for i in range(degrees_of_freedom))
        self.units = (unit,) * degrees_of_freedom

    def __call__(self, x: Tensor, t: float) -> Tensor:  # noqa: ARG002
        """Return the positions (..., n) of the states x (..., 2n)."""
        return x[..., : len(self.names)]

    def residual(self, y: Tensor, y_pred: Tensor) -> Tensor:
        """Return y - y_pred."""
        return y - y_pred


class State:
    """The whole state, positions and momenta.

    Args:
        degrees_of_freedom: n.
        units: of a position and of a momentum.
    """

    def __init__(self, degrees_of_freedom: int = 3, units: tuple[str, str] = ("km", "km/s")) -> None:
        self.names = tuple(f"{kind}{i + 1}" for kind in "qp" for i in range(degrees_of_freedom))
        self.units = (units[0],) * degrees_of_freedom + (units[1],) * degrees_of_freedom

    def __call__(self, x: Tensor, t: float) -> Tensor:  # noqa: ARG002
        """Return the states (..., 2n) themselves."""
        return x

    def residual(self, y: Tensor, y_pred: Tensor) -> Tensor:
        """Return y - y_pred."""
        return y - y_pred
