"""Controls of a stream: supplied by readings, each held until the next, or tabulated in advance."""

from __future__ import annotations

from typing import NamedTuple

import torch

from ahnn.assimilation.instrument_reading import Reading
from ahnn.controls import ControlTable
from ahnn.data.files.table import LARGEST
from ahnn.errors import UserError
from ahnn.rollouts import clock_of
from ahnn.types import Flow

Held = tuple[float | None, ...]
"""The m controls valid at a time; None for one not yet supplied by a reading."""


NONE = "none, since no force in the model depends on controls"


class StreamControls(NamedTuple):
    """Source of a filter's controls.

    Attributes:
        size: number m of controls, 0 for a process model without controls.
        known: table known in advance; None if readings supply the controls.
    """

    size: int
    known: ControlTable | None = None

    @classmethod
    def of(cls, flow: Flow, known: ControlTable | None, time: float) -> StreamControls:
        """Build the controls of a process model from the start time on.

        Raises:
            UserError: a table that does not match the model's controls, or begins after the start.
        """
        size = max(0, clock_of(flow) - 1)
        if known is not None:
            if known.values.shape != (len(known.times), size) or not size:
                expected = f"a table of {size}" if size else NONE
                message = f"controls: expected {expected}; received {tuple(known.values.shape)}"
                raise UserError(message)
            known.at(torch.tensor([time], dtype=torch.float64))
        return cls(size, known)

    @property
    def unknown(self) -> Held:
        """Controls before any reading."""
        return (None,) * self.size

    @property
    def trial(self) -> ControlTable | None:
        """Placeholder controls for a trial step whose result is discarded."""
        return self.known or (self._held((0.0,) * self.size, 0.0) if self.size else None)

    def require_fitting(self, reading: Reading) -> None:
        """Raise UserError for a reading with controls that the filter does not accept."""
        given = reading.controls
        if not given:
            return
        if self.known is not None:
            message = (
                "controls: expected controls either in a table or in readings; received a table and "
                f"{given} at time {reading.time:g}. Leave one out"
            )
            raise UserError(message)
        fits = len(given) == self.size and all(u is None or abs(u) <= LARGEST for u in given)
        if not fits:
            each = f"{self.size} finite numbers up to {LARGEST:g}, or None for an unchanged one"
            expected = each if self.size else NONE
            message = f"controls: expected {expected}; received {given}"
            raise UserError(message)

    def after(self, held: Held, reading: Reading) -> Held:
        """Return the controls valid after a reading, given the controls before it."""
        if not reading.controls:
            return held
        return tuple(u if new is None else new for u, new in zip(held, reading.controls, strict=True))

    def between(self, held: Held, since: float, time: float) -> ControlTable | None:
        """Return the controls between two times, given those valid at the first.

        Raises:
            UserError: a control without a value.
        """
        if self.known is not None or not self.size or not time > since:
            return self.known
        if None in held:
            known = self.size - held.count(None)
            received = f"{known} of {self.size}" if known else "none"
            message = (
                f"controls: expected values at the start, time {since:g}; received {received} before a "
                f"reading at time {time:g}. Begin with a reading at time {since:g} that has them, or set "
                "controls="
            )
            raise UserError(message)
        return self._held(held, since)

    def hash_before(self, time: float) -> str:
        """Return a hash of the table before a time; "" without a table."""
        return "" if self.known is None else self.known.hash_before(time)

    @staticmethod
    def _held(held: Held, since: float) -> ControlTable:
        times = torch.tensor([since], dtype=torch.float64)
        return ControlTable(times, torch.tensor([held], dtype=torch.float64))
