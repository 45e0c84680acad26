"""A stream assimilated line by line, so that a kill at any moment loses nothing and counts nothing twice.

The state is saved every so many lines, with the number of lines that it holds and the length of the output at
that moment. Whoever goes on cuts the output back to that length and takes the lines behind that number again:
the same numbers come out, bit for bit.
"""

from __future__ import annotations

import json
import logging
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from ahnn.arguments import NonNegative, Within, check_arguments
from ahnn.assimilation.cells import BadLine
from ahnn.assimilation.instrument_reading import Reading
from ahnn.assimilation.line_parser import Layout
from ahnn.assimilation.lines import Lines
from ahnn.assimilation.online import Assimilation, Diverged, Estimate
from ahnn.assimilation.output_rows import Output, Rows, digest, require_new
from ahnn.assimilation.stream_clock import StreamClock
from ahnn.data.files import sidecar
from ahnn.errors import TrainingError, UserError
from ahnn.estimation.consistency import band
from ahnn.manifest import remove_own

log = logging.getLogger("ahnn")

Watcher = Callable[[int, Reading, Estimate, Counter[str]], None]
"""Told of every line that was a measurement: its number, what it said, the estimate, the counts so far."""

FEW = 30
"""Measured numbers that say nothing yet of a filter's consistency."""
REMEDIES = {
    "none": "Add lines",
    "bad": "The lines above say what is wrong with them",
    "late": "They are before the start: set epoch= and time=, at which it holds, or window=",
    "ahead": "They are far behind the start: set epoch= and time=, at which it holds, or gap=",
    "rejected": "Set start= and start_sd=, or epoch= and time=, at which it holds, or plugins.{name}.gate",
    "repeated": "They come twice: leave state= out or begin another",
    "predicted": "Their numbers are missing: fill the columns of the sensor, or set measurement=",
}
"""What to do where most lines became so, and none was taken."""
WORDS = {
    "late": "comes later than the window allows, at time {now:g}: not counted",
    "repeated": "was counted before: not counted again",
    "ahead": "lies further ahead than a gap may be, from time {now:g}: not counted",
}


CLOCK = "epoch, time_system"
"""Keys that say what times mean."""
Natural = Annotated[int, Within(0)]


class Notes(NamedTuple):
    """What a saved state knows of the stream and of the output.

    Attributes:
        lines, place, digest: lines that it holds, their bytes, and their hash.
        header: the first of them.
        size, tail: bytes of the output, and the hash of the last of them.
        kind: of the output's rows.
        counts: outcomes of the lines.
        nis, numbers: sum of the NIS of those that counted, and how many numbers they had.
        clock: what times mean.
        begun: the start of the filter.
    """

    lines: Natural
    place: Natural
    digest: str
    header: str
    size: Natural
    tail: str
    kind: str
    counts: dict[str, int]
    nis: NonNegative
    numbers: Natural
    clock: list[Any] | None
    begun: dict[str, Any]


class Session:
    """A stream, a filter, and where estimates go.

    Args:
        assimilation: the filter.
        lines: the stream.
        rows: how estimates are written.
        output: path of the file they are written to, `-` for standard output.
        state: path of the state; None saves none.
        every: lines between two saved states.
        clock: what times mean; None takes numbers alone.
        controls: names of the controls of the model.

    Raises:
        UserError: an output that is there without its state, or a state that does not fit.
    """

    def __init__(
        self,
        assimilation: Assimilation,
        lines: Lines,
        rows: Rows,
        output: str,
        state: Path | None,
        every: int,
        clock: StreamClock | None = None,
        controls: tuple[str, ...] = (),
    ) -> None:
        self.filter, self.lines, self.rows = assimilation, lines, rows
        self.clock, self.controls = clock, controls
        self.state, self.every = state, every
        self.counts: Counter[str] = Counter()
        self.nis, self.numbers = 0.0, 0
        self.layout: Layout | None = None
        self.header, self.path = "", output
        self.beside = None if output == "-" or rows.said is None else Path(output)
        self._count()
        self.output: Output | None = None
        self.resumed, self.written = state is not None and state.exists(), False
        if state is not None and self.resumed:
            known = self._resume(assimilation.load(state))
            self.output = Output(output, rows, known.lines, known.size, known.tail)
        else:
            require_new(output)
            if self.beside is not None:
                sidecar.require_place(self.beside)
            lines.begin()

    def run(self, watch: Watcher | None = None) -> None:
        """Assimilate all lines that come.

        Raises:
            UserError: a header that names what is not there.
            TrainingError: the filter has diverged; the message names the line. Or no line counted.
        """
        try:
            self._run(watch)
        finally:
            self.close()

    def verdict(self) -> str:
        """Return whether innovations are as large as the filter believes; empty where few are known."""
        if self.numbers < FEW:
            return ""
        mean, (low, high) = self.nis / self.numbers, band(1, self.numbers)
        text = f"mean NIS of a number {mean:.3g}; {low:.3g} to {high:.3g} where a filter is consistent"
        if mean > high:
            name = self.filter.process.estimator.name
            text += (
                f": it trusts its model or the measurements too much, or took outliers (plugins.{name}.gate)"
            )
        return text + (": it trusts them too little" if mean < low else "")

    def close(self) -> None:
        """Give back the files; what was not saved is taken again by who goes on.

        Of a stream that began here and came to no estimate nothing is left.
        """
        nothing = not (self.resumed or self.written)
        self.lines.close(discard=nothing)
        if nothing and self.state is not None and self.layout is not None:
            self.state.unlink(missing_ok=True)
        if self.output is not None:
            self.output.close()
            if nothing and self.path != "-":
                Path(self.path).unlink(missing_ok=True)
            if nothing and self.beside is not None:
                remove_own(sidecar.beside(self.beside))

    def _run(self, watch: Watcher | None) -> None:
        for text in self.lines:
            if text and not text.startswith("#"):
                self._line(text, watch)
            self._count()
            if self.counted % self.every == 0 and self.layout is not None:
                self._save()
        if self.layout is None:
            message = "measurements: expected a header or JSON objects; received no line"
            raise UserError(message)
        self._save()
        self._require_taken()

    def _require_taken(self) -> None:
        """Refuse a stream of which nothing counted, unless it asks for predictions alone.

        Raises:
            TrainingError: says what became of most lines, and what to do.
        """
        assert self.layout is not None
        asks = self.counts["predicted"] and self.layout.asks
        if self.counts["taken"] or asks:
            return
        most, count = max(self.counts.items(), key=lambda item: item[1], default=("none", 0))
        received = f"{count:,} of {self.counts.total():,} {most}" if count else "no line behind the header"
        remedy = REMEDIES[most].format(name=self.filter.process.estimator.name)
        message = f"measurements: expected one that counts; received {received}. {remedy}"
        raise TrainingError(message)

    def _begin(self, text: str) -> None:
        """Take the first line, and begin the output once it is known to be good."""
        self.layout = Layout(text, self.filter.sensors, self.clock, self.controls)
        if self.output is None:
            self._save()
            self.output = Output(self.path, self.rows)
        self.header = text
        if not self.output.size:
            self.output.write(self.rows.header())
        if self.beside is not None and self.rows.said is not None:
            sidecar.write(self.beside, self.rows.said)

    def _line(self, text: str, watch: Watcher | None) -> None:
        number = self.lines.number
        if self.layout is None:
            self._begin(text)
        assert self.layout is not None
        assert self.output is not None
        if self.layout.names and text == self.header:  # it comes again where tables are joined
            return
        try:
            reading = self.layout.reading(text)
            estimate = self.filter.update(reading)
        except BadLine as error:
            self.counts["bad"] += 1
            log.info("line %d: %s; skipped", number, error)
            return
        except Diverged as error:
            message = f"line {number}: {error}. Begin again with another start, a wider gate or more noise"
            raise TrainingError(message) from error
        self.counts[estimate.outcome] += 1
        if estimate.innovation is None:
            word = WORDS[estimate.outcome].format(now=estimate.time)
            log.info("line %d: %s %s", number, reading.label, word)
        else:
            self.output.write(self.rows.row(number, reading.sensor, estimate))
            self.written = True
            nis, dof = float(estimate.innovation.nis), int(estimate.innovation.measured)
            if estimate.outcome == "rejected":
                told = number, reading.label, nis, dof
                log.info("line %d: %s rejected, NIS %.3g of %d numbers", *told)
            elif dof:
                self.nis, self.numbers = self.nis + nis, self.numbers + dof
        if watch is not None:
            watch(number, reading, estimate, self.counts)

    def _save(self) -> None:
        if self.state is None:
            return
        size, tail = 0, digest(b"")
        if self.output is not None:
            self.output.sync()
            size, tail = self.output.size, self.output.digest
        stream = (self.counted, self.place, self.digest, self.header, size, tail, self.rows.kind)
        clock = self.clock and list(self.clock)
        notes = Notes(*stream, dict(self.counts), self.nis, self.numbers, clock, self.filter.begun)
        self.filter.save(self.state, {"stream": json.dumps(notes._asdict())})
        self.lines.saved(self.place)

    def _count(self) -> None:
        """All lines so far are counted, which the next state will say."""
        self.counted, self.place, self.digest = self.lines.number, self.lines.place, self.lines.digest

    def _resume(self, notes: dict[str, str]) -> Notes:
        """Take the lines that are not in the state again, and return what it knows."""
        try:
            content = json.loads(notes["stream"])
            check_arguments("", Notes, content)
            known = Notes(**content)
            self.counts = Counter({str(word): int(count) for word, count in known.counts.items()})
        except (KeyError, ValueError, TypeError) as error:
            message = f"state: expected one of a stream; received {self.state} ({error})"
            raise UserError(message) from error
        mine = {"format": self.rows.kind, CLOCK: self.clock and list(self.clock), **self.filter.begun}
        theirs = {"format": known.kind, CLOCK: known.clock, **known.begun}
        if changed := [key for key, value in mine.items() if theirs.get(key) != value]:
            message = (
                f"{changed[0]}: expected that of {self.state}; received another. Go on with the same "
                "command, or begin again with another state and output"
            )
            raise UserError(message)
        self.header, self.nis, self.numbers = known.header, known.nis, known.numbers
        if self.header:
            self.layout = Layout(self.header, self.filter.sensors, self.clock, self.controls)
        self.lines.resume(known.lines, known.place, known.digest)
        self._count()
        log.info("going on behind line %d", known.lines)
        return known
