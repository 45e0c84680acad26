"""A catalogue divided among workers, each of which follows the objects of its shard."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import NamedTuple

from ahnn.assimilation import Catalogue
from ahnn.cli.stream import read_stream
from ahnn.files import claimed
from ahnn.jobs import joining_shards
from ahnn.jobs.assimilating_objects import CatalogueOutcome, follow_objects, require_states
from ahnn.jobs.assimilation_request import Stream
from ahnn.workers import Workers

log = logging.getLogger("ahnn")


class ShardCommand(NamedTuple):
    """Arguments of `ahnn.assimilate` for the objects of one worker, and the level of its messages."""

    arguments: list[str]
    level: int


def assimilate_sharded(stream: Stream, arguments: list[str]) -> None:
    """Assimilate a stream of many objects by several workers, into one output.

    Args:
        stream: the stream, of all objects.
        arguments: the command line from which it was built.

    Raises:
        UserError: a stream that cannot be divided, or a worker's error.
        TrainingError: no line was accepted, most were rejected, or a worker was killed repeatedly.
    """
    options, catalogue = stream.asked, stream.filtering
    assert options.workers is not None
    assert isinstance(catalogue, Catalogue)
    workers = Workers.of(options.workers)
    workers.require_installed()
    joining_shards.require_divisible(options)
    require_states(stream, catalogue)
    shards = joining_shards.shards_of(catalogue, workers.number)
    folder = Path(options.state or "")
    folder.mkdir(parents=True, exist_ok=True)
    with claimed(folder):
        commands = []
        for shard in shards:
            own = {"output": str(joining_shards.output_of(options, shard))}
            own |= {
                "state": str(folder / f"{shard.number}.state"),
                "shard": f"{shard.number}/{shard.workers}",
            }
            given = [f"{key}={_quoted(value)}" for key, value in own.items()]
            more = [*arguments, *given, "workers=null", "states=null"]
            commands.append(ShardCommand(more, log.getEffectiveLevel()))
        found = workers.map(follow_shard, commands)
        joining_shards.join(stream, catalogue, shards, found)


def follow_shard(command: ShardCommand) -> CatalogueOutcome:
    """Follow the objects of one worker in its process; messages appear on its standard error."""
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    log.setLevel(logging.ERROR)  # the parent reports everything else
    stream = read_stream(command.arguments)
    log.setLevel(command.level)
    assert isinstance(stream.filtering, Catalogue)
    return follow_objects(stream, stream.filtering, judged=False)


def _quoted(text: str) -> str:
    """Return a value in the quotes of Hydra's grammar."""
    escaped = text.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"
