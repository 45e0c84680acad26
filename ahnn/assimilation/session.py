"""Assimilation of a stream of one object, in blocks of the lines that have arrived."""

from __future__ import annotations

import logging
import math
from collections import Counter, deque
from collections.abc import Callable
from functools import cached_property
from itertools import islice, takewhile
from typing import NamedTuple, cast

from ahnn.assimilation.cells import BadLine
from ahnn.assimilation.instrument_reading import Reading
from ahnn.assimilation.lines import Lines
from ahnn.assimilation.online import Assimilation, Diverged
from ahnn.assimilation.skipped_lines import SAID, SkippedLines
from ahnn.assimilation.stream_estimate import Estimate
from ahnn.assimilation.stream_session import StreamSession
from ahnn.assimilation.stream_tally import GATED, after, capitalised
from ahnn.assimilation.table_parser import TableParser
from ahnn.errors import TrainingError

log = logging.getLogger("ahnn")

TOGETHER = 512
"""Maximum number of lines in a block, whose rows are written together."""
FAR = 100
"""Number of model steps from an undated start to the first measurement beyond which a warning is logged."""
UNLIKELY = (
    "start: all %d measurements before this one were rejected, since they are far from it. Check its frame, "
    "unit and time, or give it a larger start_sd"
)

Watcher = Callable[[int, Reading, Estimate, Counter[str]], None]
"""Callback for every measurement line: line number, reading, estimate, and counts so far."""

WORDS = {
    "late": "arrived too late, after {now} (window=): ignored",
    "repeated": "was already processed: ignored",
    "ahead": "is too far ahead of {now} (gap=): ignored",
}


class ParsedLine(NamedTuple):
    """Number and text of a line, and its reading; None for an unusual line."""

    number: int
    text: str
    reading: Reading | None


class MadeRows(NamedTuple):
    """Lines, sensors and estimates of the rows to write."""

    lines: list[int]
    sensors: list[str]
    estimates: list[Estimate]


class Session(StreamSession):
    """Session for one object; arguments as in `StreamSession`, with an `Assimilation` as filter.

    Attributes:
        fitted: number of the last line to which the start was fitted; lines up to it are skipped.
        undated: whether the time of the start is assumed, since none is stated.
        since: time of the filter when this command began; lines before it may have been sent again.
        rejected: number of lines rejected since the last accepted one.
    """

    filter: Assimilation
    lines: Lines
    fitted: int = 0
    undated: bool = False
    since: float = -math.inf
    rejected: int = 0

    @cached_property
    def skipped(self) -> SkippedLines:
        """Report of invalid lines."""
        return SkippedLines()

    @cached_property
    def ignored(self) -> Counter[str]:
        """Numbers of lines without an estimate in this command, by outcome."""
        return Counter()

    @cached_property
    def parser(self) -> TableParser:
        """Parser of lines, once their layout is known."""
        assert self.layout is not None
        columns = dict.fromkeys(name for one in self.filter.sensors.values() for name in one.columns)
        return TableParser(self.layout, tuple(columns))

    def run(self, watch: Watcher | None = None) -> None:
        """Assimilate all lines of the stream.

        Raises:
            UserError: the header contains unknown names.
            TrainingError: the filter has diverged (the message names the line), or no line was accepted.
        """
        try:
            self._run(watch)
        finally:
            self.close()
            self.skipped.conclude()

    def _run(self, watch: Watcher | None) -> None:
        self.since = self.filter.window.time
        while texts := self.lines.arrived(min(TOGETHER, self.every - self.counted % self.every)):
            self._block(texts, watch)
            self._count()
            if self.counted % self.every == 0 and self.layout is not None:
                self._save()
        self._end()

    def _block(self, texts: list[str], watch: Watcher | None) -> None:
        """Process lines, and write the rows of all processed lines even if a later line fails."""
        readings = self._readings(self._numbered(texts))
        made = MadeRows([], [], [])
        try:
            while readings:
                self._next(readings, made, watch)
        finally:
            if made.lines:
                assert self.output is not None
                self.output.write(self.rows.rows(*made))
                self.written = True

    def _readings(self, there: list[tuple[int, str]]) -> deque[ParsedLine]:
        """Return the readings of numbered lines, without those to which the start was fitted."""
        if self.layout is None:
            return deque()
        fitted = sum(number <= self.fitted for number, _ in there)
        self.counts.update({"fitted": fitted} if fitted else {})
        there = there[fitted:]
        found = self.parser.readings([text for _, text in there])
        return deque(ParsedLine(*line, reading) for line, reading in zip(there, found, strict=True))

    def _next(self, lines: deque[ParsedLine], made: MadeRows, watch: Watcher | None) -> None:
        """Remove from a block the next lines that can be filtered together, at least one, and filter them."""
        number, text, reading = lines[0]
        assert self.layout is not None
        try:
            first = self.layout.reading(text) if reading is None else reading
            self._warn_of_far(first.time)
            others = takewhile(lambda line: line.reading is not None, islice(lines, 1, None))
            readings = [first, *(cast(Reading, line.reading) for line in others)]
            estimates = self.filter.updates(readings)
        except BadLine as error:
            lines.popleft()
            self.counts["bad"] += 1
            self.skipped.add(number, error)
            return
        except Diverged as error:
            message = f"line {number}: {error}. Start over with a different start, or with larger noise"
            raise TrainingError(message + after(". ", capitalised(self.ratios.sentence()))) from error
        for reading, estimate in zip(readings, estimates, strict=False):
            number = lines.popleft().number
            if estimate.innovation is not None:
                made.lines.append(number)
                made.sensors.append(reading.sensor)
                made.estimates.append(estimate)
            self._tell(number, reading, estimate)
            if watch is not None:
                watch(number, reading, estimate, self.counts)

    def _tell(self, number: int, reading: Reading, estimate: Estimate) -> None:
        """Count an estimate, and report it unless the reading was simply accepted."""
        self.counts[estimate.outcome] += 1
        if estimate.outcome in GATED:
            self.gated[reading.sensor] += 1
            self.refused[reading.sensor] += estimate.outcome == "rejected"
            self.rejected = self.rejected + 1 if estimate.outcome == "rejected" else 0
        if estimate.outcome == "taken" and estimate.innovation is not None:
            self.nis += float(estimate.innovation.nis)
            self.numbers += int(estimate.innovation.measured)
            return
        self.disordered += estimate.outcome == "late" and reading.time > self.since
        label = self._said(reading.time) + (f" from sensor {reading.sensor}" if reading.sensor else "")
        if estimate.innovation is None:
            self.ignored[estimate.outcome] += 1
            if (count := self.ignored[estimate.outcome]) <= SAID:
                word = WORDS[estimate.outcome].format(now=self._said(estimate.time))
                rest = "; further ones are counted" if count == SAID else ""
                log.info("line %d: %s %s%s", number, label, word, rest)
        elif estimate.outcome == "rejected":
            name = reading.sensor or next(iter(self.filter.sensors))
            own = self.filter.sensors[name].columns, reading.values, estimate.innovation.residual
            self.ratios.add(name, *own)
            if self.rejected <= SAID:
                values = number, label, float(estimate.innovation.nis), int(estimate.innovation.measured)
                rest = "; further consecutive ones are counted" if self.rejected == SAID else ""
                log.info("line %d: %s rejected, NIS %.3g for %d values%s", *values, rest)
        elif estimate.outcome == "reopened":
            words = "reopened the gate after consecutive rejections; the covariance was enlarged"
            name = reading.sensor or next(iter(self.filter.sensors))
            self.ratios.close(name)
            log.info("line %d: %s %s", number, label, words)
            if not self.numbers and self.counts["reopened"] == 1:
                log.warning(UNLIKELY, self.counts["rejected"])
            if suspicion := self.ratios.sentence(name):
                message = (
                    f"line {number}: expected measurements near the estimates; received consecutive ones far "
                    f"from them. {capitalised(suspicion)}"
                )
                raise TrainingError(message)

    def _said(self, time: float) -> str:
        """Return a time for messages."""
        return f"time {time:g}" if self.clock is None else self.clock.said(time)

    def _warn_of_far(self, time: float) -> None:
        """Warn of a first measurement far from a start without a stated time."""
        if self.undated and abs(time - self.filter.window.time) > FAR * self.filter.process.max_step:
            message = (
                "start: no time is stated; %g is assumed, but the first measurement is at %g. Set time= to "
                "the time of the initial state"
            )
            log.warning(message, self.filter.window.time, time)
        self.undated = False
