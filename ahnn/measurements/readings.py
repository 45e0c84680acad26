"""The two models that read the state itself."""

from __future__ import annotations

from torch import Tensor

from ahnn.labels import momentum_unit
from ahnn.measurements.angles import Differing
from ahnn.measurements.base import Measurement, Time
from ahnn.types import Space


class Position(Differing):
    """The first n of 2 n state components: the positions q, as in the paper.

    Args:
        degrees_of_freedom: n.
        unit: of a position.
    """

    def __init__(self, degrees_of_freedom: int = 3, unit: str = "km") -> None:
        self.names = tuple(f"q{i + 1}" for i in range(degrees_of_freedom))
        self.units = (unit,) * degrees_of_freedom

    def __call__(self, x: Tensor, t: Time) -> Tensor:  # noqa: ARG002
        """Return the positions (..., n) of the states x (..., 2n)."""
        return x[..., : len(self.names)]

    def locate(self, y: Tensor, t: Time) -> Tensor:  # noqa: ARG002
        """Return the positions themselves, shape (..., n)."""
        return y


class State(Differing):
    """The whole state, positions and momenta.

    Args:
        degrees_of_freedom: n.
        units: of a position and of a momentum.
    """

    def __init__(self, degrees_of_freedom: int = 3, units: tuple[str, str] = ("km", "km/s")) -> None:
        self.names = tuple(f"{kind}{i + 1}" for kind in "qp" for i in range(degrees_of_freedom))
        self.units = (units[0],) * degrees_of_freedom + (units[1],) * degrees_of_freedom

    def __call__(self, x: Tensor, t: Time) -> Tensor:  # noqa: ARG002
        """Return the states (..., 2n) themselves."""
        return x

    def locate(self, y: Tensor, t: Time) -> Tensor:  # noqa: ARG002
        """Return the states themselves, shape (..., 2n)."""
        return y


def reading(name: str, space: Space) -> Measurement:
    """Return the measurement called `position` or `state` of a space.

    Raises:
        ValueError: another name.
    """
    if name == "position":
        return Position(space.dof, space.units.position)
    if name == "state":
        momentum = f"{space.units.velocity} · mass" if space.mechanical else momentum_unit(space)
        return State(space.dof, (space.units.position, momentum))
    message = f"expected state, position or a model; received {name!r}"
    raise ValueError(message)
