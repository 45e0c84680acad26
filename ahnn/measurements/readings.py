"""Measurement models of the positions and of the full state."""

from __future__ import annotations

from torch import Tensor

from ahnn.labels import momentum_unit, of_coordinates
from ahnn.measurements.angles import Differing
from ahnn.measurements.base import Measurement, Time
from ahnn.types import Space


class Position(Differing):
    """The first n of 2 n state components: the positions q, as in the paper.

    Args:
        degrees_of_freedom: number n of degrees of freedom.
        unit: unit of all positions, or of each.
        names: names of the n positions; None for q1, q2, ...
    """

    def __init__(
        self,
        degrees_of_freedom: int = 3,
        unit: str | tuple[str, ...] = "km",
        names: tuple[str, ...] | None = None,
    ) -> None:
        self.names = names or tuple(f"q{i + 1}" for i in range(degrees_of_freedom))
        self.units = of_each(unit, degrees_of_freedom)

    def __call__(self, x: Tensor, t: Time) -> Tensor:
        """Return the positions (..., n) of the states x (..., 2n)."""
        return x[..., : len(self.names)]

    def locate(self, y: Tensor, t: Time) -> Tensor:
        """Return the positions themselves, shape (..., n)."""
        return y


class State(Differing):
    """The full state, positions and momenta.

    Args:
        degrees_of_freedom: number n of degrees of freedom.
        units: units of positions and of momenta, or of each.
        names: names of the 2n components; None for q1, ..., p1, ...
    """

    def __init__(
        self,
        degrees_of_freedom: int = 3,
        units: tuple[str | tuple[str, ...], str | tuple[str, ...]] = ("km", "km/s"),
        names: tuple[str, ...] | None = None,
    ) -> None:
        self.names = names or tuple(f"{kind}{i + 1}" for kind in "qp" for i in range(degrees_of_freedom))
        self.units = sum((of_each(unit, degrees_of_freedom) for unit in units), ())

    def __call__(self, x: Tensor, t: Time) -> Tensor:
        """Return the states (..., 2n) themselves."""
        return x

    def locate(self, y: Tensor, t: Time) -> Tensor:
        """Return the states themselves, shape (..., 2n)."""
        return y


def of_each(unit: str | tuple[str, ...], count: int) -> tuple[str, ...]:
    """Expand units to one per component."""
    return (unit,) * count if isinstance(unit, str) else unit


def reading(name: str, space: Space) -> Measurement:
    """Build the measurement named `position` or `state` of a space, with the names of its components.

    Raises:
        ValueError: unknown name.
    """
    alike = [of_coordinates(space, angle=angle) for angle in space.angular]
    positions = tuple(one.units.position for one in alike)
    if name == "position":
        return Position(space.dof, positions, space.components[: space.dof])
    if name == "state":
        momenta = [f"{s.units.velocity} · mass" if s.mechanical else momentum_unit(s) for s in alike]
        return State(space.dof, (positions, tuple(momenta)), space.components)
    message = f"expected state, position or a model; received {name!r}"
    raise ValueError(message)
