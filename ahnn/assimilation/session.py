"""Assimilation of a stream of one object, line by line."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable

from ahnn.assimilation.cells import BadLine
from ahnn.assimilation.instrument_reading import Reading
from ahnn.assimilation.lines import Lines
from ahnn.assimilation.online import Assimilation, Diverged, Estimate
from ahnn.assimilation.stream_session import StreamSession
from ahnn.errors import TrainingError

log = logging.getLogger("ahnn")

FAR = 100
"""Steps of the model between an undated start and the first measurement that are worth a warning."""

Watcher = Callable[[int, Reading, Estimate, Counter[str]], None]
"""Callback for every measurement line: line number, reading, estimate, and counts so far."""

WORDS = {
    "late": "is later than the window allows, at {now}: ignored",
    "repeated": "was already processed: ignored",
    "ahead": "is further ahead than the largest gap allowed, from {now}: ignored",
}


class Session(StreamSession):
    """Session for one object; arguments as in `StreamSession`, preceded by an `Assimilation`.

    Attributes:
        fitted: number of the last line to which the start was fitted; lines up to it are skipped.
        undated: whether nothing states the time of the start.
    """

    filter: Assimilation
    lines: Lines
    fitted: int = 0
    undated: bool = False

    def run(self, watch: Watcher | None = None) -> None:
        """Assimilate all lines of the stream.

        Raises:
            UserError: a header with unknown names.
            TrainingError: the filter has diverged, with the line in the message, or no line was accepted.
        """
        try:
            self._run(watch)
        finally:
            self.close()

    def _run(self, watch: Watcher | None) -> None:
        for text in self.lines:
            if text and not text.startswith("#"):
                self._line(text, watch)
            self._count()
            if self.counted % self.every == 0 and self.layout is not None:
                self._save()
        self._end()

    def _line(self, text: str, watch: Watcher | None) -> None:
        number = self.lines.number
        if self.layout is None:
            self._begin(text)
        assert self.layout is not None
        assert self.output is not None
        if self.layout.names and text == self.header:  # repeated header where tables are concatenated
            return
        if number <= self.fitted:
            self.counts["fitted"] += 1
            return
        try:
            reading = self.layout.reading(text)
            self._warn_of_far(reading.time)
            estimate = self.filter.update(reading)
        except BadLine as error:
            self.counts["bad"] += 1
            log.info("line %d: %s; skipped", number, error)
            return
        except Diverged as error:
            message = f"line {number}: {error}. Start over with another start, or more noise"
            raise TrainingError(message) from error
        self.counts[estimate.outcome] += 1
        self.disordered += estimate.outcome == "late" and reading.time > self.filter.begun["time"]
        label = self._said(reading.time) + (f" of sensor {reading.sensor}" if reading.sensor else "")
        if estimate.innovation is None:
            word = WORDS[estimate.outcome].format(now=self._said(estimate.time))
            log.info("line %d: %s %s", number, label, word)
        else:
            self.output.write(self.rows.row(number, reading.sensor, estimate))
            self.written = True
            nis, dof = float(estimate.innovation.nis), int(estimate.innovation.measured)
            if estimate.outcome == "rejected":
                told = number, label, nis, dof
                log.info("line %d: %s rejected, NIS %.3g for %d values", *told)
            elif estimate.outcome == "reopened":
                words = "reopened the gate after consecutive rejections; the covariance was enlarged"
                log.info("line %d: %s %s", number, label, words)
            elif dof:
                self.nis, self.numbers = self.nis + nis, self.numbers + dof
        if watch is not None:
            watch(number, reading, estimate, self.counts)

    def _said(self, time: float) -> str:
        """Return a time for messages."""
        return f"time {time:g}" if self.clock is None else self.clock.said(time)

    def _warn_of_far(self, time: float) -> None:
        """Warn of a first measurement far from a start without a stated time."""
        if self.undated and abs(time - self.filter.window.time) > FAR * self.filter.process.max_step:
            message = (
                "start: its time is taken as %g, and the first measurement is at %g. Set time= of the start"
            )
            log.warning(message, self.filter.window.time, time)
        self.undated = False
