"""Controls of a stream: those that its readings bring, each held until the next, or a table of them."""

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
"""The m controls that hold at a time; None for one that no reading has brought yet."""


NONE = "none, since no force of the model depends on any"


class StreamControls(NamedTuple):
    """Where a filter has its controls from.

    Attributes:
        size: m, 0 for a process model without controls.
        known: all of them, known ahead; None where readings bring them.
    """

    size: int
    known: ControlTable | None = None

    @classmethod
    def of(cls, flow: Flow, known: ControlTable | None, time: float) -> StreamControls:
        """Return the controls of a process model that begins at a time.

        Raises:
            UserError: a table of other controls than the model has, or one that begins later.
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
        """What holds before any reading."""
        return (None,) * self.size

    @property
    def trial(self) -> ControlTable | None:
        """Controls for a step whose result does not count."""
        return self.known or (self._held((0.0,) * self.size, 0.0) if self.size else None)

    def require_fitting(self, reading: Reading) -> None:
        """Refuse a reading with controls that the filter does not take; raises UserError."""
        given = reading.controls
        if not given:
            return
        if self.known is not None:
            message = (
                f"controls: expected a table or readings that have them; received both, {given} in that of "
                f"time {reading.time:g}. Leave one out"
            )
            raise UserError(message)
        fits = len(given) == self.size and all(u is None or abs(u) <= LARGEST for u in given)
        if not fits:
            each = f"{self.size} finite numbers up to {LARGEST:g}, None for one that stays as it is"
            expected = each if self.size else NONE
            message = f"controls: expected {expected}; received {given}"
            raise UserError(message)

    def after(self, held: Held, reading: Reading) -> Held:
        """Return what holds from a reading on, where something else held before it."""
        if not reading.controls:
            return held
        return tuple(u if new is None else new for u, new in zip(held, reading.controls, strict=True))

    def between(self, held: Held, since: float, time: float) -> ControlTable | None:
        """Return the controls from one time to another, at the first of which some hold.

        Raises:
            UserError: one that nobody has said.
        """
        if self.known is not None or not self.size or not time > since:
            return self.known
        if None in held:
            known = self.size - held.count(None)
            received = f"{known} of {self.size}" if known else "none"
            message = (
                f"controls: expected them from the start on, at time {since:g}; received {received} before a "
                f"reading of time {time:g}. Begin with one of time {since:g} that has them, or set controls="
            )
            raise UserError(message)
        return self._held(held, since)

    def hash_before(self, time: float) -> str:
        """Return the hash of what a table says before a time; "" without one."""
        return "" if self.known is None else self.known.hash_before(time)

    @staticmethod
    def _held(held: Held, since: float) -> ControlTable:
        times = torch.tensor([since], dtype=torch.float64)
        return ControlTable(times, torch.tensor([held], dtype=torch.float64))
