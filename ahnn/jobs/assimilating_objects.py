"""Assimilation of measurements of many objects, in tables of lines."""

from __future__ import annotations

import gc
import logging
from contextlib import closing
from pathlib import Path

import torch

from ahnn.assimilation import Catalogue
from ahnn.assimilation.catalogue_rows import OBJECT, CatalogueRows
from ahnn.assimilation.catalogue_session import CatalogueSession
from ahnn.assimilation.lines import Lines
from ahnn.assimilation.object_shard import ObjectShard
from ahnn.assimilation.output_rows import Format
from ahnn.assimilation.parquet_stream import ParquetRows
from ahnn.assimilation.view import said
from ahnn.data.estimate_table import described, track_names
from ahnn.data.starts import Starts
from ahnn.jobs.assimilation_request import AssimilationRequest, Stream, opened
from ahnn.prediction import output
from ahnn.prediction.propagation import Prediction

log = logging.getLogger("ahnn")

TOGETHER = 100_000
"""Number of lines per table, and between saved states."""


def assimilate_objects(stream: Stream, catalogue: Catalogue) -> None:
    """Assimilate all lines of a stream of many objects, and write a table of their final states.

    Raises:
        UserError: a missing file, or one that does not match the saved state.
        TrainingError: no line was accepted, or most were rejected.
    """
    options, space = stream.asked, stream.space
    state, objects = None if options.state is None else Path(options.state), options.objects or ""
    table = described(space, stream.reference)
    beside = table._replace(columns={**table.columns, "id": OBJECT})
    if options.states:
        output.require_output(Path(options.states), _last(stream, catalogue), space)
    with closing(_lines(options.measurements, state)) as lines:
        names = track_names(space)
        rows = CatalogueRows(names, catalogue.sensors, _kind(options), beside, scales=space.scales)
        every = options.every or TOGETHER
        given = options.output, state, every, stream.clock
        shard = ObjectShard.of(options.shard)
        session = CatalogueSession(catalogue, lines, rows, *given, objects=objects, shard=shard)
        gc.collect()
        gc.freeze()
        session.run()
    log.info("%s lines: %s", f"{session.counted:,}", said(session.counts))
    log.info("%s objects, %d of them lost", f"{len(catalogue.names):,}", len(catalogue.lost))
    if verdict := session.verdict():
        log.info(verdict)
    if options.states:
        last = _last(stream, catalogue)
        assert last.covariances is not None
        found = Prediction(last.times.new_zeros(1), last.states[:, None], last.covariances[:, None])
        output.write(Path(options.states), found, last, space)
    session.require_followed()


def _last(stream: Stream, catalogue: Catalogue) -> Starts:
    """Return the final states of objects, as starts of predictions."""
    times, beliefs = catalogue.beliefs()
    return Starts(
        tuple(catalogue.names), beliefs.mean, torch.from_numpy(times), stream.reference, beliefs.covariance
    )


def _lines(path: str, state: Path | None) -> Lines | ParquetRows:
    """Return the lines of a stream, or the rows of a Parquet file."""
    if path != "-" and Path(path).is_file():
        with open(path, "rb") as file:
            if file.read(4) == b"PAR1":
                return ParquetRows(path)
    return Lines(opened(path, state))


def _kind(options: AssimilationRequest) -> Format:
    """Return the output format, as requested or by the file extension."""
    suffix = Path(options.output).suffix.lower()
    known: dict[str, Format] = {".json": "json", ".jsonl": "json", ".parquet": "parquet"}
    return options.format or known.get(suffix, "csv")
