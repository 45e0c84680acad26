"""A stream that is assimilated so that a kill at any moment loses nothing and counts nothing twice.

The state is saved every so many lines, with the number of lines that it holds and the length of the output at
that moment. Whoever goes on cuts the output back to that length and takes the lines behind that number again:
the same numbers come out, bit for bit.
"""

from __future__ import annotations

import json
import logging
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Protocol

from ahnn.arguments import NonNegative, Within, check_arguments
from ahnn.assimilation.line_parser import Layout
from ahnn.assimilation.lines import Lines
from ahnn.assimilation.output_rows import Output, Rows, digest, require_new
from ahnn.assimilation.parquet_stream import ParquetRows
from ahnn.assimilation.stream_clock import StreamClock
from ahnn.assimilation.stream_sensor import StreamSensor
from ahnn.data.files import sidecar
from ahnn.errors import TrainingError, UserError
from ahnn.estimation.consistency import band
from ahnn.estimation.process_model import Process
from ahnn.manifest import remove_own

log = logging.getLogger("ahnn")

FEW = 30
"""Measured numbers that say nothing yet of a filter's consistency."""
MANY = 0.05
"""Fraction of refused measurements that outliers alone seldom are."""
REMEDIES = {
    "none": "Add lines",
    "bad": "The lines above say what is wrong with them",
    "late": "They are before the start: set epoch= and time=, at which it holds, or window=",
    "ahead": "They are far behind the start: set epoch= and time=, at which it holds, or gap=",
    "rejected": "Set start= and start_sd=, or epoch= and time=, at which it holds, or gate=",
    "repeated": "They come twice: leave state= out or begin another",
    "lost": "Their filters have failed: set start= and start_sd=, or gate=",
    "unknown": "Their objects have no start: name the table of them, start=FILE, or one for all, start=[..]",
    "predicted": "Their numbers are missing: fill the columns of the sensor, or set measurement=",
}
"""What to do where most lines became so, and none was taken."""

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


class StreamFilter(Protocol):
    """What filters a stream: one object, or many."""

    sensors: dict[str, StreamSensor]
    process: Process
    begun: dict[str, Any]

    def save(self, path: str | Path, notes: Mapping[str, str] | None = None) -> None:
        """Write all that is needed to go on."""
        ...

    def load(self, path: str | Path) -> dict[str, str]:
        """Go on where `save` was called, and return the notes that were kept there."""
        ...


class StreamSession:
    """A stream, what filters it, and where estimates go; a subclass takes its lines.

    Args:
        filtering: the filter, or those of many objects.
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
        filtering: StreamFilter,
        lines: Lines | ParquetRows,
        rows: Rows,
        output: str,
        state: Path | None,
        every: int,
        clock: StreamClock | None = None,
        controls: tuple[str, ...] = (),
    ) -> None:
        self.filter, self.lines, self.rows = filtering, lines, rows
        self.clock, self.controls = clock, controls
        self.state, self.every = state, every
        self.counts: Counter[str] = Counter()
        self.nis, self.numbers = 0.0, 0
        self.layout: Layout | None = None
        self.header, self.path = "", output
        self.beside = None if output == "-" or rows.said is None else Path(output)
        self._count()
        self.output: Any = None
        self.resumed, self.written = state is not None and state.exists(), False
        if state is not None and self.resumed:
            known = self._resume(filtering.load(state))
            self.output = self._output(known)
        else:
            require_new(output)
            if self.beside is not None:
                sidecar.require_place(self.beside)
            lines.begin()

    def verdict(self) -> str:
        """Return whether innovations are as large as the filter believes; empty where few are known."""
        if self.numbers < FEW:
            return ""
        mean, (low, high) = self.nis / self.numbers, band(1, self.numbers)
        text = f"mean NIS of a number {mean:.3g}; {low:.3g} to {high:.3g} where a filter is consistent"
        if mean > high:
            text += ": it trusts its model or the measurements too much, or took outliers (gate=)"
        return text + (": it trusts them too little" if mean < low else "") + self._of_the_gate()

    def _of_the_gate(self) -> str:
        """Return what a mean of what was taken does not show: how much was refused; "" where it is little."""
        refused, opened = self.counts["rejected"], self.counts["reopened"]
        fraction = refused / (refused + opened + self.counts["taken"])
        if not opened and fraction < MANY:
            return ""
        times = f", and opened again {opened:,} times after too many in a row" if opened else ""
        return f"; the gate refused {100 * fraction:.2g} % of the measurements{times}"

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
            if nothing:
                self.output.remove(self.path)
            if nothing and self.beside is not None:
                remove_own(sidecar.beside(self.beside))

    def _end(self) -> None:
        """Save what came of a stream that has ended; raises where nothing did."""
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
        if self.counts["taken"] or self.counts["reopened"] or asks:
            return
        most, count = max(self.counts.items(), key=lambda item: item[1], default=("none", 0))
        received = f"{count:,} of {self.counts.total():,} {most}" if count else "no line behind the header"
        message = f"measurements: expected one that counts; received {received}. {REMEDIES[most]}"
        raise TrainingError(message)

    def _output(self, known: Notes | None) -> Any:
        """Return where rows go, as a state knows it; None begins."""
        if known is None:
            return Output(self.path, self.rows)
        return Output(self.path, self.rows, known.lines, known.size, known.tail)

    def _layout(self, first: str) -> Layout:
        """Return how lines are read, of which one is the first."""
        return Layout(first, self.filter.sensors, self.clock, self.controls)

    def _begin(self, text: str) -> None:
        """Take the first line, and begin the output once it is known to be good."""
        self.layout = self._layout(text)
        if self.output is None:
            self._save()
            self.output = self._output(None)
        self.header = text
        if not self.output.size and (head := self.rows.header()):
            self.output.write(head)
        if self.beside is not None and self.rows.said is not None:
            sidecar.write(self.beside, self.rows.said)

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
            self.layout = self._layout(self.header)
        self.lines.resume(known.lines, known.place, known.digest)
        self._count()
        log.info("going on behind line %d", known.lines)
        return known
