"""Crash-safe assimilation of a stream: a crash at any moment neither loses nor repeats a line.

The state is saved at regular intervals, with the number of lines processed and the length of the output. On
resumption the output is truncated to that length and later lines are processed again, with bitwise equal
results.
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
from ahnn.assimilation.stream_tally import StreamTally
from ahnn.data.files import sidecar
from ahnn.errors import UserError
from ahnn.estimation.process_model import Process
from ahnn.manifest import remove_own

log = logging.getLogger("ahnn")

CLOCK = "epoch, time_system"
"""Configuration keys that define the meaning of times."""
Natural = Annotated[int, Within(0)]


class Notes(NamedTuple):
    """Information on stream and output in a saved state.

    Attributes:
        lines, place, digest: number of processed lines, their length in bytes, and their hash.
        header: first line.
        size, tail: size of the output, and hash of its last bytes.
        kind: format of the output.
        counts: number of lines by outcome.
        nis, numbers: sum of the NIS of accepted lines, and their number of values.
        clock: interpretation of times.
        begun: start of the filter.
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
    """Filter of a stream, for one object or many."""

    sensors: dict[str, StreamSensor]
    process: Process
    begun: dict[str, Any]

    def save(self, path: str | Path, notes: Mapping[str, str] | None = None) -> None:
        """Save the complete state for resuming."""
        ...

    def load(self, path: str | Path) -> dict[str, str]:
        """Restore the state written by `save`, and return its notes."""
        ...


class StreamSession(StreamTally):
    """Session of stream, filter and output; subclasses process the lines.

    Args:
        filtering: filter of one object, or filters of many.
        lines: lines of the stream.
        rows: formatter of estimates.
        output: path of the output file, `-` for standard output.
        state: path of the state; None: not saved.
        every: number of lines between saved states.
        clock: interpretation of times; None for plain numbers.
        controls: names of the controls of the model.

    Raises:
        UserError: an existing output without its state, or an incompatible state.
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
        super().__init__()
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

    def close(self) -> None:
        """Close the files; unsaved lines are processed again on resumption.

        Files of a new stream without any estimate are removed.
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

    def _end(self, *, judged: bool = True) -> None:
        """Save the final state at the end of a stream; with `judged`, raise if no line was accepted."""
        if self.layout is None:
            message = "measurements: expected a header or JSON objects; received no line"
            raise UserError(message)
        self._save()
        self.asks = self.layout.asks
        if judged:
            self.require_taken()

    def _output(self, known: Notes | None) -> Any:
        """Open the output recorded in a state, or a new one for None."""
        if known is None:
            return Output(self.path, self.rows)
        return Output(self.path, self.rows, known.lines, known.size, known.tail)

    def _layout(self, first: str) -> Layout:
        """Determine the line format from the first line."""
        return Layout(first, self.filter.sensors, self.clock, self.controls)

    def _begin(self, text: str) -> None:
        """Read the first line, and start the output once it is validated."""
        self.layout = self._layout(text)
        if self.output is None:
            self._save()
            self.output = self._output(None)
        self.header = text
        if not self.output.size and (head := self.rows.header()):
            self.output.write(head)
        if self.beside is not None and self.rows.said is not None:
            sidecar.write(self.beside, self.rows.said)

    def _numbered(self, texts: list[str]) -> list[tuple[int, str]]:
        """Begin with the first line; return numbered lines without blanks, comments and repeated headers."""
        first = self.lines.number - len(texts) + 1
        there = [(first + k, text) for k, text in enumerate(texts) if text and not text.startswith("#")]
        if self.layout is None and there:
            self._begin(there[0][1])
        if self.layout is None or not self.layout.names:
            return there
        return [(number, text) for number, text in there if text != self.header]

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
        """Update the notes of the next saved state with all lines so far."""
        self.counted, self.place, self.digest = self.lines.number, self.lines.place, self.lines.digest

    def _resume(self, notes: dict[str, str]) -> Notes:
        """Resume after the lines included in the state, and return its notes."""
        try:
            content = json.loads(notes["stream"])
            check_arguments("", Notes, content)
            known = Notes(**content)
            self.counts = Counter({str(word): int(count) for word, count in known.counts.items()})
        except (KeyError, ValueError, TypeError) as error:
            message = f"state: expected the state of a stream; received {self.state} ({error})"
            raise UserError(message) from error
        mine = {"format": self.rows.kind, CLOCK: self.clock and list(self.clock), **self.filter.begun}
        theirs = {"format": known.kind, CLOCK: known.clock, **known.begun}
        if changed := [key for key, value in mine.items() if theirs.get(key) != value]:
            message = (
                f"{changed[0]}: expected the value stored in {self.state}; received a different value. "
                "Repeat the original command, or start over with a new state and output"
            )
            raise UserError(message)
        self.header, self.nis, self.numbers = known.header, known.nis, known.numbers
        if self.header:
            self.layout = self._layout(self.header)
            self.layout.levelled = True
        self.lines.resume(known.lines, known.place, known.digest)
        self._count()
        log.info("resuming after line %d", known.lines)
        return known
