"""Times of a stream: numbers since time zero, or calendar epochs."""

from __future__ import annotations

from typing import Any, NamedTuple

from ahnn.assimilation.cells import BadLine, number
from ahnn.data.files.epochs import DATE, SECOND, instant, spelled
from ahnn.data.files.frames import TO_TT
from ahnn.data.files.units import TIME, factor, unit
from ahnn.data.reference import Reference
from ahnn.errors import UserError


class StreamClock(NamedTuple):
    """Interpretation of times.

    Attributes:
        unit: unit of numeric times.
        zero: epoch of time zero (`ahnn.data.files.epochs`); None for plain numbers.
        system: time scale of epochs, such as UTC.
        scale: unit of the stream's numeric times, as a multiple of `unit`.
        dated: whether only epochs are accepted, because the origin of numeric times is unknown.
        cells: time scale of the epochs in a stream; "": the time scale of time zero.
    """

    unit: str
    zero: int | None
    system: str
    scale: float = 1.0
    dated: bool = False
    cells: str = ""

    def time(self, cell: Any) -> float:
        """Parse the time in a cell, NaN if it is missing.

        Raises:
            BadLine: the cell is not a time.
            UserError: the cell is an epoch but time zero has none, or a number without a known origin.
        """
        if not (isinstance(cell, str) and (DATE.match(cell) or "T" in cell)):
            time = self.scale * number(cell, "time")
            if self.dated and time == time:
                start = spelled(self.zero or 0, utc=self.system == "UTC")
                message = (
                    f"measurements: expected epochs, since the start has an epoch, {start}; received time "
                    f"{cell}. Add epoch= (for time zero), or time= (for the start)"
                )
                raise UserError(message)
            return time
        if self.zero is None:
            message = (
                "epoch: expected the epoch of time zero, since the measurements have epochs, for example "
                f"{cell[:40]}; received none. Add epoch="
            )
            raise UserError(message)
        system = self.cells or self.system
        try:
            moment = Reference(clock=system, epoch=instant(cell, utc=system == "UTC")).on(self.system).epoch
        except ValueError as error:
            message = f"time: expected {error}; received {cell[:40]!r}"
            raise BadLine(message) from error
        return self.between(self.zero, moment)

    def between(self, one: int | None, other: int | None) -> float:
        """Return the time between two epochs."""
        return ((other or 0) - (one or 0)) / SECOND / self.second

    def after(self, moment: int | None, time: float) -> int:
        """Return the epoch at a given time after another."""
        return (moment or 0) + round(time * self.second * SECOND)

    def epoch(self, time: float) -> str:
        """Return the epoch at a time, in ISO form; "" if time zero has none."""
        return "" if self.zero is None else spelled(self.after(self.zero, time), utc=self.system == "UTC")

    def said(self, time: float) -> str:
        """Return a time for messages, preceded by its epoch if there is one."""
        plain = f"time {time:g}"
        return plain if self.zero is None else f"{self.epoch(time)[:19]} ({plain} {self.unit})"

    @property
    def second(self) -> float:
        """Seconds of the unit; 1 without a known unit."""
        clock = unit(self.unit)
        return clock.size if clock.dimension == TIME else 1.0

    def named(self, text: str) -> StreamClock:
        """Return the clock with the time unit or time scale of a header; raises UserError for others."""
        if text == self.system or {text, self.system} <= TO_TT.keys():
            return self._replace(cells=text)
        try:
            return self._replace(scale=factor(text, self.unit))
        except ValueError as error:
            message = (
                f"measurements: expected times in {self.unit}, in another unit of time, or as epochs in "
                f"{self.system}; received {text}. Convert them, or set time_system"
            )
            raise UserError(message) from error
