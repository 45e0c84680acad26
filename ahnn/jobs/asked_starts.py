"""Starts given to a command, in the reference of its model."""

from __future__ import annotations

from typing import Any

from ahnn.data.reference import Reference
from ahnn.data.starts import Starts, referred, starts
from ahnn.errors import UserError
from ahnn.types import Space


def asked_starts(
    given: str | list[Any],
    sd: list[float] | None,
    epoch: str | None,
    frame: str | list[str] | None,
    space: Space,
) -> Starts:
    """Read the starts of a command; arguments as in the help of `ahnn.predict`.

    Raises:
        UserError: invalid starts, or two epochs of time zero.
    """
    named = ", ".join(frame) if isinstance(frame, list) else frame or ""
    ours = Reference.of(space.frame).chosen(Reference.of(named)).since(epoch)
    found = starts(given, space, ours, sd=sd)
    if epoch is not None and found.reference.epoch is not None:
        message = f"epoch: expected none, since the start file has its own; received {epoch}"
        raise UserError(message)
    found = referred(found, ours)
    return found._replace(reference=found.reference.centred(space.units.position))
