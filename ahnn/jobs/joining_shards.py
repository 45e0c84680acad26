"""Division of a catalogue into shards for several workers, and merging of their outputs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch

from ahnn.assimilation import Catalogue
from ahnn.assimilation.merged_rows import MergedRows
from ahnn.assimilation.object_shard import ObjectShard
from ahnn.assimilation.reading_table import COUNTED, FATES
from ahnn.assimilation.stream_tally import StreamTally
from ahnn.data.files import sidecar
from ahnn.data.starts import Starts
from ahnn.errors import UserError
from ahnn.jobs.assimilating_objects import CatalogueOutcome, conclude, rows_of
from ahnn.jobs.assimilation_request import AssimilationRequest, Stream
from ahnn.manifest import require_own


def require_divisible(options: AssimilationRequest) -> None:
    """Raise UserError for a stream that cannot be divided among workers."""
    expected = {
        "output": ("a .csv or .jsonl FILE", options.output, Path(options.output).suffix != ".parquet"),
        "state": ("a FOLDER for the states of the workers", options.state, options.state is not None),
        "measurements": ("a FILE that every worker reads", options.measurements, True),
        "shard": ("none, since workers have one each", options.shard, options.shard is None),
    }
    for key, (words, received, is_right) in expected.items():
        if not is_right or received == "-":
            message = f"{key}: expected {words} with workers={options.workers}; received {received or 'none'}"
            raise UserError(message)
    state = Path(options.state or "")
    if state.exists() and not state.is_dir():
        message = f"state: expected a folder with workers={options.workers}; received {state}, a file"
        raise UserError(message)
    require_own([Path(options.output)], "output")
    sidecar.require_place(Path(options.output))


def shards_of(catalogue: Catalogue, workers: int) -> list[ObjectShard]:
    """Return the shards of at most `workers` workers, each with at least one object."""
    for count in range(workers, 0, -1):
        shards = [ObjectShard(number, count) for number in range(1, count + 1)]
        if not catalogue.names or all(shard.holds(catalogue.names).any() for shard in shards):
            return shards
    return []


def output_of(options: AssimilationRequest, shard: ObjectShard) -> Path:
    """Return the path of the output of one worker."""
    return Path(options.state or "", f"{shard.number}{Path(options.output).suffix}")


def join(
    stream: Stream, catalogue: Catalogue, shards: Sequence[ObjectShard], found: Sequence[CatalogueOutcome]
) -> None:
    """Merge the outputs of all workers into one, and conclude as for a single worker.

    Raises:
        UserError: the outputs do not have one row for each assimilated line.
        TrainingError: no line was accepted, or most were rejected.
    """
    options, tally = stream.asked, StreamTally.joined(one.tally for one in found)
    tally.require_taken()
    rows, path = rows_of(stream, catalogue), Path(options.output)
    merged = MergedRows(rows, [output_of(options, shard) for shard in shards])
    merged.write(path, sum(tally.counts[fate] for fate in FATES[:COUNTED]))
    if rows.said is not None:
        sidecar.write(path, rows.said)
    order = catalogue.names or (merged.objects() if options.states else ())
    last = together([one.last for one in found], {name: k for k, name in enumerate(order)})
    conclude(stream, CatalogueOutcome(tally, last, sum(one.lost for one in found)))


def together(parts: Sequence[Starts], order: dict[str, int]) -> Starts:
    """Return the states of all parts, sorted by the given order of names; unknown names come last."""
    objects = [one for part in parts for one in part.objects]
    rows = sorted(range(len(objects)), key=lambda k: order.get(objects[k].id, len(order)))
    states = torch.cat([part.states for part in parts])[rows]
    times = torch.cat([part.times for part in parts])[rows]
    covariances = torch.cat([part.covariances for part in parts if part.covariances is not None])[rows]
    chosen = tuple(objects[k] for k in rows)
    return Starts(chosen, states, times, parts[0].reference, covariances)
