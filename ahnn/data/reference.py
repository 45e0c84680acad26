"""References of data: frame, centre, time scale and epoch of time zero, and their compatibility."""

from __future__ import annotations

import logging
import math
import re
from typing import NamedTuple

from ahnn.data.files.epochs import DAY, SECOND, instant, leaps, spelled
from ahnn.data.files.frame_names import FIXED_AT, INERTIAL, ROTATING, canonical, known
from ahnn.data.files.frames import CLOCKS, TO_TT
from ahnn.errors import UserError

log = logging.getLogger("ahnn")

SINCE = re.compile(r"from (?P<epoch>\S+)( (?P<clock>\S+))?")
BODY = "EARTH"
"""Default centre of a model without one."""
EARTHLY = ("EME2000", "GCRF", "TEME", "CIRS")
"""Frames whose centre is the Earth unless another one is stated."""


class Reference(NamedTuple):
    """Reference of positions and times; "" or None if unspecified.

    Attributes:
        frame: axes of the positions, such as EME2000.
        center: body at their origin, such as EARTH.
        clock: time scale of epochs, such as UTC.
        epoch: epoch of time zero in this time scale (`ahnn.data.files.epochs`).
    """

    frame: str = ""
    center: str = ""
    clock: str = ""
    epoch: int | None = None

    @classmethod
    def of(cls, text: str) -> Reference:
        """Parse a text such as `EME2000, EARTH, UTC, from 2024-03-01T12:00:00.000`."""
        words = [word.removeprefix("?") for word in canonical(text).split(", ")]
        since = SINCE.fullmatch(words[-1])
        frame, center, clock = [*words[: len(words) - (since is not None)], "", "", ""][:3]
        clock = clock.upper()
        if since is None:
            return cls(frame, center, clock)
        clock = clock or since["clock"] or "UTC"
        try:
            return cls(frame, center, clock, instant(since["epoch"], utc=clock == "UTC"))
        except ValueError:
            return cls(frame, center, clock)

    def __str__(self) -> str:
        names = [name or "?" for name in self[:3]] if any(self[:3]) else []
        if self.epoch is not None:
            names.append(f"from {self.spelled()}")
        return ", ".join(names)

    def described(self) -> str:
        """Return the reference for readers, with the names that are not stated; "" if nothing is stated."""
        if not any(self[:3]) and self.epoch is None:
            return ""
        missing = [name for name, own in zip(("frame", "centre"), self[:2], strict=True) if not own]
        parts = [name for name in self[:3] if name]
        parts += [f"{' and '.join(missing)} not stated (frame=)"] if missing else []
        if self.epoch is not None:
            parts.append(f"time zero {self.spelled()}")
        return ", ".join(parts)

    def spelled(self, later: int = 0) -> str:
        """Return the epoch, or a moment `later` picoseconds after it, in its time scale; "" without epoch."""
        return "" if self.epoch is None else spelled(self.epoch + later, utc=self.clock == "UTC")

    def on(self, clock: str) -> Reference:
        """Convert the epoch to another time scale; raises UserError for an unknown offset."""
        if self.epoch is None or "" in (clock, self.clock) or clock == self.clock:
            return self._replace(clock=clock or self.clock)
        if not {clock, self.clock} <= TO_TT.keys():
            message = f"time system: expected {self.clock}, or both of {', '.join(TO_TT)}; received {clock}"
            raise UserError(message)
        shift = round((TO_TT[self.clock] - TO_TT[clock]) * SECOND)
        return self._replace(clock=clock, epoch=self.epoch + shift)

    def earth_angle(self) -> float:
        """Return the Earth's rotation angle at the epoch in rad (IERS Conventions 2010, 5.15), UT1 = UTC."""
        moment = self.on("UTC").epoch or 0
        seconds = moment / SECOND - leaps(moment // SECOND // DAY)
        days = seconds / DAY - 0.5  # since J2000.0
        return math.tau * ((0.7790572732640 + 0.00273781191135448 * days + days % 1.0) % 1.0)

    def filled(self, other: Reference) -> Reference:
        """Fill missing fields from another reference; its epoch is converted to this time scale."""
        frame, center, clock = (mine or theirs for mine, theirs in zip(self[:3], other[:3], strict=True))
        epoch = self.epoch if self.epoch is not None else other.on(clock).epoch
        return Reference(frame, center, clock, epoch)

    def chosen(self, keys: Reference) -> Reference:
        """Combine the reference of a run with the user's settings, which take precedence.

        Raises:
            UserError: a frame or centre that differs from that of the run, or an unknown time scale.
        """
        if keys.clock and keys.clock not in CLOCKS:
            message = f"time system: expected one of {', '.join(CLOCKS)}; received {keys.clock}"
            raise UserError(message)
        for name in ("frame", "center"):
            ours, theirs = getattr(self, name), getattr(keys, name)
            if ours and theirs and alias(ours) != alias(theirs):
                message = f"{name}: expected {ours}, as in the model; received {theirs}. Leave it out"
                if name == "frame" and known(ours) and alias(theirs) in INERTIAL:
                    message += f"; ahnn.predict converts predictions with output_frame={alias(theirs)}"
                raise UserError(message)
        return keys.filled(self)

    def since(self, text: str | None) -> Reference:
        """Set the epoch given by a user; None: unchanged.

        Raises:
            UserError: invalid epoch.
        """
        if text is None:
            return self
        clock = self.clock or "UTC"
        try:
            return self._replace(clock=clock, epoch=instant(text, utc=clock == "UTC"))
        except ValueError as error:
            message = f"epoch: expected {error}; received {text!r}"
            raise UserError(message) from error

    def centred(self, length: str) -> Reference:
        """Set the centre assumed if none is stated, and report it."""
        found = self.assumed(length)
        if found != self:
            log.info("center: not stated; %s, the centre of %s, is assumed", found.center, self.frame)
        return found

    def assumed(self, length: str) -> Reference:
        """Set the Earth as the centre of `EARTHLY` frames with positions in km or m, if none is stated."""
        if self.center or self.frame.partition(FIXED_AT)[0] not in EARTHLY or length not in ("km", "m"):
            return self
        return self._replace(center=BODY)

    def turn(self, ours: Reference, who: str) -> str | None:
        """Return the frame to which data must be transformed for a model; None: no transformation.

        Args:
            ours: reference of the model.
            who: description of the data, for messages.

        Raises:
            UserError: another centre, or a frame that cannot be transformed to the frame of the model.
        """
        body = ours.center or BODY
        if self.center and alias(self.center) != alias(body):
            remedy = "Convert it" if ours.center else f"Set frame= or center= if {self.center} is right"
            message = f"{who}: expected centre {body}, as in the model; received {self.center}. {remedy}"
            raise UserError(message)
        wanted, given = alias(ours.frame), alias(self.frame)
        if not given or wanted == given:
            return None
        if known(wanted) not in ("", "ITRF") and known(self.frame):
            return wanted
        if wanted or given.startswith(ROTATING):
            expected = f"frame {ours.frame}, as in the model" if wanted else "an inertial frame"
            remedy = "Convert it" if wanted else "Set frame= to the frame of the model, such as GCRF"
            message = f"{who}: expected {expected}; received {self.frame}. {remedy}"
            raise UserError(message)
        return None


def alias(name: str) -> str:
    """Return the canonical name of a frame or a body."""
    return known(name) or canonical(name).upper()
