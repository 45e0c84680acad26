"""Times of a stream: numbers from time zero, or epochs of the calendar."""

from __future__ import annotations

from typing import Any, NamedTuple

from ahnn.assimilation.cells import BadLine, number
from ahnn.data.files.epochs import SECOND, instant
from ahnn.data.files.units import TIME, factor, unit
from ahnn.errors import UserError


class Clock(NamedTuple):
    """What times mean.

    Attributes:
        unit: of numbers.
        zero: epoch of time zero (`ahnn.data.files.epochs`).
        system: time system of epochs, such as UTC.
        scale: of the unit in which a stream has numbers, in that unit.
    """

    unit: str
    zero: int
    system: str
    scale: float = 1.0

    @classmethod
    def of(cls, base: str, epoch: str, system: str) -> Clock:
        """Return the clock of a space.

        Args:
            base: its unit of time; without one a number is taken as seconds.
            epoch: of time zero.
            system: time system of the epochs.

        Raises:
            UserError: no epoch.
        """
        try:
            return cls(base, instant(epoch, utc=system == "UTC"), system)
        except ValueError as error:
            message = f"epoch: expected {error}; received {epoch!r}"
            raise UserError(message) from error

    def time(self, cell: Any) -> float:
        """Return the time in a cell, NaN where it is missing; raises BadLine for what is no time."""
        if not (isinstance(cell, str) and "T" in cell):
            return self.scale * number(cell, "time")
        try:
            moment = instant(cell, utc=self.system == "UTC")
        except ValueError as error:
            message = f"time: expected {error}; received {cell[:40]!r}"
            raise BadLine(message) from error
        size = unit(self.unit).size if unit(self.unit).dimension == TIME else 1.0
        return (moment - self.zero) / SECOND / size

    def named(self, text: str) -> Clock:
        """Return the clock of a header that names a unit of time or a time system; raises UserError."""
        if text == self.system:
            return self
        try:
            return self._replace(scale=factor(text, self.unit))
        except ValueError as error:
            message = (
                f"measurements: expected times in {self.unit}, another unit of time or epochs of "
                f"{self.system}; received {text}. Convert them, or set time_system"
            )
            raise UserError(message) from error
