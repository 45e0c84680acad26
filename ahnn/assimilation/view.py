"""Live view of an assimilation: redrawn in place on a terminal, periodic lines elsewhere."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Iterator
from types import TracebackType

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from ahnn.assimilation.instrument_reading import Reading
from ahnn.assimilation.stream_estimate import Estimate
from ahnn.estimation.consistency import band
from ahnn.labels import duration, physical_components
from ahnn.types import Space

LAST = 100
"""Number of readings whose mean NIS is shown."""
OFTEN, SELDOM = 0.2, 5.0
"""Seconds between redraws on a terminal, and between lines elsewhere."""


class View:
    """View of estimate, 3-sigma, innovations, NIS and counts on standard error, since rows may use stdout.

    Args:
        space: description of the state components.
        console: console to draw on; None for standard error.
    """

    def __init__(self, space: Space, console: Console | None = None) -> None:
        self.space, self.console = space, console or Console(stderr=True)
        self.live = Live(console=self.console, auto_refresh=False) if self.console.is_terminal else None
        self.recent: deque[tuple[float, int]] = deque(maxlen=LAST)
        self.drawn = float("-inf")
        self.last: tuple[int, Reading, Estimate, Counter[str]] | None = None

    def __enter__(self) -> View:
        if self.live is not None:
            self.live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.last is not None:
            self._draw(*self.last)
        if self.live is not None:
            self.live.stop()

    def __call__(self, line: int, reading: Reading, estimate: Estimate, counts: Counter[str]) -> None:
        """Show an estimate, at a limited rate."""
        innovation = estimate.innovation
        if estimate.outcome == "taken" and innovation is not None and int(innovation.measured):
            self.recent.append((float(innovation.nis), int(innovation.measured)))
        self.last = line, reading, estimate, counts
        now = time.monotonic()
        if now - self.drawn >= (SELDOM if self.live is None else OFTEN):
            self.drawn = now
            self._draw(*self.last)

    def _draw(self, line: int, reading: Reading, estimate: Estimate, counts: Counter[str]) -> None:
        if self.live is not None:
            self.live.update(self.table(line, reading, estimate, counts), refresh=True)
            return
        state = "  ".join(f"{name} {value:.6g} ± {3 * sd:.2g}" for name, value, sd in self._rows(estimate))
        when = duration(estimate.time, self.space)
        text = f"line {line}, time {when}: {state}; {self.consistency()}; {summary(counts)}"
        self.console.print(text, highlight=False, markup=False, soft_wrap=True)

    def table(self, line: int, reading: Reading, estimate: Estimate, counts: Counter[str]) -> Table:
        """Build the table shown on a terminal."""
        table = Table(title=f"{self.space.name}: line {line}, time {duration(estimate.time, self.space)}")
        for head in ("", "estimate", "3 sigma"):
            table.add_column(head, justify="right")
        for name, value, sd in self._rows(estimate):
            table.add_row(Text(name), f"{value:.8g}", f"{3 * sd:.3g}")  # as a string, [m] would be markup
        table.caption = "\n".join(
            (f"{reading.sensor or 'no sensor'}: {described(estimate)}", self.consistency(), summary(counts))
        )
        return table

    def consistency(self) -> str:
        """Format the mean NIS of the last accepted readings with its 95 % band."""
        if not self.recent:
            return "no innovation yet"
        mean, degrees = (sum(values) / len(self.recent) for values in zip(*self.recent, strict=True))
        low, high = band(degrees, len(self.recent))
        return (
            f"mean NIS of the last {len(self.recent)} accepted readings {mean:.3g}, 95 % band {low:.3g} to "
            f"{high:.3g}"
        )

    def _rows(self, estimate: Estimate) -> Iterator[tuple[str, float, float]]:
        """Return name with unit, estimate and standard deviation of each component, or velocity."""
        deviations = estimate.covariance.diagonal().clamp(min=0.0).sqrt()
        values = ((part / self.space.scales).tolist() for part in (estimate.mean, deviations))
        return zip(physical_components(self.space), *values, strict=True)


def described(estimate: Estimate) -> str:
    """Format the innovations of a reading in standard deviations."""
    if estimate.innovation is None or not int(estimate.innovation.measured):
        return estimate.outcome
    ratio = (estimate.innovation.residual / estimate.innovation.deviation)[0].tolist()
    return f"{estimate.outcome}, innovation [sigma] " + " ".join(f"{value:+.2f}" for value in ratio)


def summary(counts: Counter[str]) -> str:
    """Format the counts of lines by outcome."""
    return ", ".join(f"{count:,} {word}" for word, count in sorted(counts.items())) or "no line yet"
