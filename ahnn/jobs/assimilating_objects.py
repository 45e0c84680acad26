"""Assimilation of measurements of many objects, in tables of lines."""

from __future__ import annotations

import gc
import logging
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import torch

from ahnn.assimilation import Catalogue
from ahnn.assimilation.catalogue_rows import CatalogueRows
from ahnn.assimilation.catalogue_session import CatalogueSession
from ahnn.assimilation.lines import Lines
from ahnn.assimilation.object_shard import ObjectShard
from ahnn.assimilation.output_rows import Format
from ahnn.assimilation.parquet_stream import ParquetRows
from ahnn.assimilation.stream_tally import StreamTally
from ahnn.assimilation.view import summary
from ahnn.data.estimate_table import OBJECT, described, track_names
from ahnn.data.files.object_name import ObjectName, names_by_id
from ahnn.data.starts import Starts
from ahnn.jobs.assimilation_request import AssimilationRequest, Stream, opened
from ahnn.prediction import output
from ahnn.prediction.propagation import Prediction
from ahnn.uncertainty import BEYOND

log = logging.getLogger("ahnn")

TOGETHER = 100_000
"""Number of lines per table, and between saved states."""


class CatalogueOutcome(NamedTuple):
    """Outcome of a stream of many objects, or of the objects of one worker.

    Attributes:
        tally: outcomes of the lines.
        last: final states.
        lost: number of lost objects.
    """

    tally: StreamTally
    last: Starts
    lost: int


def assimilate_objects(stream: Stream, catalogue: Catalogue) -> None:
    """Assimilate all lines of a stream of many objects, and write a table of their final states.

    Raises:
        UserError: a missing file, or one that does not match the saved state.
        TrainingError: no line was accepted, or most were rejected.
    """
    require_states(stream, catalogue)
    conclude(stream, follow_objects(stream, catalogue))


def require_states(stream: Stream, catalogue: Catalogue) -> None:
    """Raise UserError if the table of final states cannot be written."""
    if stream.asked.states:
        output.require_output(Path(stream.asked.states), _last(stream, catalogue), stream.space)


def follow_objects(stream: Stream, catalogue: Catalogue, *, judged: bool = True) -> CatalogueOutcome:
    """Assimilate all lines of a stream, and write the estimates.

    Args:
        stream: the stream.
        catalogue: filters of the objects.
        judged: whether a stream without any accepted line is an error; False for one of several workers.

    Raises:
        UserError: a missing file, or one that does not match the saved state.
        TrainingError: no line was accepted, if `judged`.
    """
    options = stream.asked
    state, objects = None if options.state is None else Path(options.state), options.objects or ""
    with closing(_lines(options.measurements, state)) as lines:
        given = options.output, state, options.every or TOGETHER, stream.clock
        shard, rows = ObjectShard.of(options.shard), rows_of(stream, catalogue)
        session = CatalogueSession(catalogue, lines, rows, *given, objects=objects, shard=shard)
        gc.collect()
        gc.freeze()
        session.run(judged=judged)
    tally = StreamTally.joined([session])
    return CatalogueOutcome(tally, _last(stream, catalogue), len(catalogue.lost))


def rows_of(stream: Stream, catalogue: Catalogue) -> CatalogueRows:
    """Return the formatter of a stream's estimates."""
    space, kind = stream.space, _kind(stream.asked)
    table = described(space, stream.reference, names_by_id(stream.objects.values()))
    beside = table._replace(columns={**table.columns, "id": OBJECT})
    names, clock = track_names(space), stream.clock
    return CatalogueRows(names, catalogue.sensors, kind, beside, scales=space.scales, clock=clock)


def conclude(stream: Stream, found: CatalogueOutcome) -> None:
    """Report the outcome of a stream and write the final states.

    Raises:
        TrainingError: most lines were rejected.
    """
    tally, last = found.tally, found.last
    log.info("%s lines: %s", f"{tally.counts.total():,}", summary(tally.counts))
    log.info("%s objects, %d of them lost", f"{len(last.names):,}", found.lost)
    if verdict := tally.verdict():
        log.info(verdict)
    for remark in (*tally.of_sensors(), *_of_novelty(stream, last)):
        log.warning(remark)
    if stream.asked.states:
        assert last.covariances is not None
        states = Prediction(last.times.new_zeros(1), last.states[:, None], last.covariances[:, None])
        output.write(Path(stream.asked.states), states, last, stream.space, correlated=True)
    tally.require_followed()


def _of_novelty(stream: Stream, last: Starts) -> list[str]:
    """Return a remark on objects whose last estimates are beyond the training data, if there are any."""
    if stream.novelty is None:
        return []
    far = stream.novelty(last.states[:, : len(stream.space.components)]).nan_to_num(0.0)
    count, worst = int((far > BEYOND).sum()), int(far.argmax())
    remark = (
        f"novelty: the last estimates of {count:,} of {len(far):,} objects lie beyond the training data, "
        f"that of {last.names[worst]} {float(far[worst]):.3g} times as far as its edge. Errors there may be "
        "far larger than the standard deviations"
    )
    return [remark] if count else []


def _last(stream: Stream, catalogue: Catalogue) -> Starts:
    """Return the final states of the objects, as starts for predictions."""
    times, beliefs = catalogue.beliefs()
    objects = tuple(stream.objects.get(name, ObjectName(name)) for name in catalogue.names)
    return Starts(objects, beliefs.mean, torch.from_numpy(times), stream.reference, beliefs.covariance)


def _lines(path: str, state: Path | None) -> Lines | ParquetRows:
    """Return the lines of a stream, or the rows of a Parquet file."""
    if path != "-" and Path(path).is_file():
        with open(path, "rb") as file:
            if file.read(4) == b"PAR1":
                return ParquetRows(path)
    return Lines(opened(path, state))


def _kind(options: AssimilationRequest) -> Format:
    """Return the output format: the requested one, or the one of the file extension."""
    suffix = Path(options.output).suffix.lower()
    known: dict[str, Format] = {".json": "json", ".jsonl": "json", ".parquet": "parquet"}
    return options.format or known.get(suffix, "csv")
