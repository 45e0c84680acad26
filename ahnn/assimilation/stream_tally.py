"""Numbers of lines of a stream by outcome, consistency of its innovations, and verdicts on both."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from ahnn.assimilation.unit_mistakes import RejectedRatios
from ahnn.errors import TrainingError
from ahnn.estimation.consistency import band

FEW = 30
"""Number of measured values below which consistency is not judged."""
LEAST = 10
"""Number of lines below which the fraction of accepted lines is not judged."""
MANY = 0.05
"""Fraction of rejected measurements that outliers rarely reach."""
GATED = ("taken", "reopened", "rejected")
"""Outcomes of measurements on which the gate decided."""
OVERCONFIDENT = (
    "this one is overconfident, since process noise or measurement noise is too small, or outliers were "
    "accepted (gate=)"
)
TOO_CAUTIOUS = "this one is too cautious, since process noise or measurement noise is too large"
REMEDIES = {
    "none": "Add lines",
    "bad": "The lines above state the faults",
    "late": "They precede the start: set its time (time=, and epoch= for time zero), or window=",
    "ahead": "They are too long after the start: set its time (time=, and epoch= for time zero), or gap=",
    "rejected": "Check the units of the measurements, or set start= and start_sd=, the time of the start "
    "(time=, and epoch= for time zero), or gate=",
    "repeated": "They were already processed: leave state= out, or start over with a new one",
    "lost": "Their filters have failed: set start= and start_sd=, or gate=",
    "unknown": "Their objects have no start: give a table of starts, start=FILE, or one start for all, "
    "start=[..]",
    "fitted": "The start uses all of them: set fitted=N to use fewer",
    "predicted": "Their values are missing: fill the columns of the sensor, or set measurement=",
}
"""Remedies by the most frequent outcome, if no line was accepted."""


class StreamTally:
    """Total outcome of a stream.

    Attributes:
        counts: number of lines by outcome.
        nis, numbers: sum of the NIS of accepted lines, and their number of values.
        disordered: number of late lines after the time at which this command began.
        gated, refused: number of lines by sensor on which the gate decided, and which it rejected, likewise.
        ratios: rejected measurements beside their predictions, likewise.
        asks: whether the stream may consist of requests for predictions alone.
    """

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.nis, self.numbers = 0.0, 0
        self.disordered, self.asks = 0, False
        self.gated: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()
        self.ratios = RejectedRatios()

    @classmethod
    def joined(cls, parts: Iterable[StreamTally]) -> StreamTally:
        """Return the total of streams of different objects."""
        total = StreamTally()
        for part in parts:
            total.counts.update(part.counts)
            total.gated.update(part.gated)
            total.refused.update(part.refused)
            total.ratios.update(part.ratios)
            total.nis, total.numbers = total.nis + part.nis, total.numbers + part.numbers
            total.disordered, total.asks = total.disordered + part.disordered, total.asks or part.asks
        return total

    def verdict(self) -> str:
        """Return a verdict on the consistency of innovations; empty if there are few."""
        if self.numbers < FEW:
            return ""
        mean, (low, high) = self.nis / self.numbers, band(1, self.numbers)
        text = f"mean NIS per value {mean:.3g}; a consistent filter has {low:.3g} to {high:.3g}"
        if mean > high:
            text += f": {OVERCONFIDENT}"
        return text + (f": {TOO_CAUTIOUS}" if mean < low else "") + self._of_the_gate()

    def _of_the_gate(self) -> str:
        """Return a remark on the fraction of rejected measurements; "" if it is small."""
        refused, opened = self.counts["rejected"], self.counts["reopened"]
        fraction = refused / (refused + opened + self.counts["taken"])
        if not opened and fraction < MANY:
            return ""
        count = "once" if opened == 1 else f"{opened:,} times"
        times = f", and reopened {count} after too many consecutive rejections" if opened else ""
        times += after("; ", self.ratios.sentence()) if opened else ""
        return f"; the gate rejected {100 * fraction:.2g} % of the measurements{times}"

    def of_sensors(self) -> list[str]:
        """Return a remark on each of several sensors of which most lines were rejected."""
        return [
            f"{refused:,} of {self.gated[name]:,} lines of {name} were rejected: check its coordinates, "
            f"units and noise{after('; ', self.ratios.sentence(name))}"
            for name, refused in self.refused.items()
            if len(self.gated) > 1 and self.gated[name] >= LEAST and 2 * refused > self.gated[name]
        ]

    def require_taken(self) -> None:
        """Check that some line was accepted, unless the stream only requests predictions.

        Raises:
            TrainingError: no line was accepted; the message states the most frequent outcome and a remedy.
        """
        predicts = self.asks and self.counts["predicted"]
        if self.counts["taken"] or self.counts["reopened"] or predicts:
            return
        most, count = max(self.counts.items(), key=lambda item: item[1], default=("none", 0))
        received = f"{count:,} of {self.counts.total():,} {most}" if count else "no line after the header"
        suspicion = after(". ", capitalised(self.ratios.sentence()) if most == "rejected" else "")
        message = (
            f"measurements: expected at least one usable line; received {received}. {REMEDIES[most]}"
            f"{suspicion}"
        )
        raise TrainingError(message)

    def require_followed(self) -> None:
        """Check that at least half of the usable lines were accepted.

        Raises:
            TrainingError: fewer than half were accepted; the message names what to check.
        """
        refused = {"rejected": self.counts["rejected"], "late": self.disordered}
        usable = self.counts["taken"] + self.counts["reopened"] + sum(refused.values())
        if usable < LEAST or 2 * sum(refused.values()) <= usable:
            return
        received = " and ".join(f"{count:,} {word}" for word, count in refused.items() if count)
        order = ", and sort the rows by time" if refused["late"] else ""
        message = (
            f"measurements: expected a filter that follows them; received {received} of {usable:,} lines. "
            f"Check the units, the order of columns and rows, the stations and the start{order}"
            f"{after('. ', capitalised(self.ratios.sentence()))}"
        )
        raise TrainingError(message)


def after(before: str, text: str) -> str:
    """Return a text after another one; "" if it is empty."""
    return before + text if text else ""


def capitalised(text: str) -> str:
    """Return a text whose first letter is a capital."""
    return text[:1].upper() + text[1:]
