"""Assimilation of a stream with many objects, in tables of lines."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ahnn.assimilation.catalogue import Catalogue
from ahnn.assimilation.catalogue_rows import CatalogueRows
from ahnn.assimilation.line_parser import Layout
from ahnn.assimilation.lines import Lines
from ahnn.assimilation.object_shard import ObjectShard
from ahnn.assimilation.parquet_stream import ParquetParts, ParquetRows
from ahnn.assimilation.reading_table import FATES, CatalogueEstimates
from ahnn.assimilation.stream_clock import StreamClock
from ahnn.assimilation.stream_session import Notes, StreamSession
from ahnn.assimilation.stream_tally import GATED
from ahnn.assimilation.table_parser import ParsedLines, TableParser
from ahnn.errors import UserError

log = logging.getLogger("ahnn")

SAID = 5
"""Number of lines per table reported individually for each outcome; more are only counted."""
UNLIKELY = (
    "object %s: all its measurements before were rejected, since they are far from its start. Check its "
    "frame, unit and time, or give it a larger start_sd"
)
NAMED = 1000
"""Number of unknown object names remembered, so that each is reported once."""


class CatalogueSession(StreamSession):
    """Session for many objects; arguments as in `StreamSession`, the column of object names, and a shard.

    The state is saved after each table, so that a restart forms the same tables and reproduces results
    bitwise.
    """

    filter: Catalogue
    rows: CatalogueRows

    def __init__(
        self,
        filtering: Catalogue,
        lines: Lines | ParquetRows,
        rows: CatalogueRows,
        output: str,
        state: Path | None,
        every: int,
        clock: StreamClock | None = None,
        *,
        objects: str,
        shard: ObjectShard = ObjectShard(),  # noqa: B008 - a tuple
    ) -> None:
        self.objects, self.shard, self.unknown = objects, shard, set[str]()
        self.met = set[str]()
        super().__init__(filtering, lines, rows, output, state, every, clock)

    def run(self, *, judged: bool = True) -> None:
        """Assimilate all lines of the stream.

        Args:
            judged: whether a stream without any accepted line is an error; False for one of several workers.

        Raises:
            UserError: the header contains unknown names.
            TrainingError: no line was accepted.
        """
        try:
            for parsed in self._tables():
                self._take(self.shard.lines(parsed))
                self._count()
                self._save()
            self._end(judged=judged)
        finally:
            self.close()

    def _layout(self, first: str) -> Layout:
        return Layout(first, self.filter.sensors, self.clock, objects=self.objects)

    def _output(self, known: Notes | None) -> Any:
        if self.rows.kind != "parquet":
            return super()._output(known)
        return ParquetParts(self.path) if known is None else ParquetParts(self.path, known.size, known.tail)

    def _tables(self) -> Iterator[ParsedLines]:
        """Yield the readings of batches of lines."""
        if isinstance(self.lines, ParquetRows):
            for numbers, columns in self.lines.batches(self.every):
                parser = self._parser(self.lines.header)
                if self.layout is None or self.layout.names is None:
                    message = "measurements: expected a table with column names; received JSON"
                    raise UserError(message)
                yield parser.of_columns(numbers, dict(zip(self.layout.names, columns, strict=True)))
            return
        while texts := self.lines.table(self.every):
            if there := self._numbered(texts):
                yield self._parser(self.header).of_lines([n for n, _ in there], [text for _, text in there])

    def _parser(self, first: str) -> TableParser:
        """Build the line parser from the first line."""
        if self.layout is None:
            self._begin(first)
        assert self.layout is not None
        return TableParser(self.layout, self.filter.columns)

    def _take(self, parsed: ParsedLines) -> None:
        """Filter the readings of a table, write the estimates, and report ignored lines."""
        found = self.filter.update(parsed.table)
        assert self.output is not None
        if found.counted.any():
            self.output.write(self.rows.batch(parsed.lines, parsed.table, found))
            self.written = True
        bad = dict(parsed.bad)
        for k, reason in found.reasons.items():
            if FATES[found.fates[k]] == "bad":
                bad[parsed.lines[k]] = reason
            else:
                name, line = parsed.table.objects[k], parsed.lines[k]
                log.warning(
                    "line %d: object %s: %s. Later lines of this object are ignored", line, name, reason
                )
        counts = np.bincount(found.fates, minlength=len(FATES)).tolist()
        self.counts.update({fate: count for fate, count in zip(FATES, counts, strict=True) if count})
        self.counts.update({"bad": len(parsed.bad)} if parsed.bad else {})
        self._count_sensors(parsed, found)
        taken = (found.fates == FATES.index("taken")) & (found.measured.numpy() > 0)
        self.nis += float(found.nis.numpy()[taken].sum())
        self.numbers += int(found.measured.numpy()[taken].sum())
        _say("bad", {line: f"{bad[line]}; skipped" for line in sorted(bad)})
        self._say_others(parsed, found)

    def _count_sensors(self, parsed: ParsedLines, found: CatalogueEstimates) -> None:
        """Count the readings of each sensor on which the gate decided."""
        for k, name in enumerate(self.filter.sensors):
            fates = Counter(FATES[fate] for fate in found.fates[parsed.table.sensors == k].tolist())
            self.gated.update({name: gated} if (gated := sum(fates[fate] for fate in GATED)) else {})
            self.refused.update({name: fates["rejected"]} if fates["rejected"] else {})
            if fates["rejected"]:
                own = (parsed.table.sensors == k) & (found.fates == FATES.index("rejected"))
                columns = self.filter.sensors[name].columns
                places = [self.filter.columns.index(column) for column in columns]
                pair = (part[own][:, places] for part in (parsed.table.values, found.residuals.numpy()))
                self.ratios.add(name, columns, *pair)

    def _say_others(self, parsed: ParsedLines, found: CatalogueEstimates) -> None:
        """Report readings with the outcomes in `WORDS`, and unknown objects."""
        for fate, words in WORDS.items():
            chosen = np.flatnonzero(found.fates == FATES.index(fate)).tolist()
            _say(fate, {parsed.lines[k]: f"object {parsed.table.objects[k]} {words}" for k in chosen})
        unknown = np.flatnonzero(found.fates == FATES.index("unknown")).tolist()
        new = {parsed.table.objects[k]: parsed.lines[k] for k in reversed(unknown)}
        new = {name: line for name, line in new.items() if name not in self.unknown}
        self.unknown |= {*islice(new, max(0, NAMED - len(self.unknown)))}
        self._warn_of_starts(parsed.table.objects, found.fates)
        _say("unknown", {line: f"object {name} has no start: ignored" for name, line in new.items()})

    def _warn_of_starts(self, objects: list[str], fates: NDArray[Any]) -> None:
        """Warn once of each start from which no measurement was accepted before its gate reopened.

        A resumed session does not know which objects were met before.
        """
        taken, opened = ({*np.flatnonzero(fates == FATES.index(name))} for name in ("taken", "reopened"))
        for k in sorted(taken | opened) if opened and not self.resumed else ():
            if k in opened and objects[k] not in self.met:
                log.warning(UNLIKELY, objects[k])
            self.met.add(objects[k])
        self.met.update(objects[k] for k in taken)


WORDS = {
    "late": "arrived too late (window=): ignored",
    "repeated": "was already processed: ignored",
    "ahead": "is too far ahead (gap=): ignored",
    "rejected": "rejected by the gate",
    "reopened": "reopened the gate after consecutive rejections; the covariance was enlarged",
}


def _say(fate: str, lines: dict[int, str]) -> None:
    """Report lines, the first ones individually."""
    for number in sorted(lines)[:SAID]:
        log.info("line %d: %s", number, lines[number])
    if len(lines) > SAID:
        log.info("%s more lines %s, up to line %d", f"{len(lines) - SAID:,}", fate, max(lines))
