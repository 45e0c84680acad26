"""Assignment of catalogue objects to workers by a hash of their names."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ahnn.assimilation.reading_table import ReadingTable
from ahnn.assimilation.table_parser import Mask, ParsedLines
from ahnn.errors import UserError
from ahnn.estimation import Belief


class ObjectShard(NamedTuple):
    """One of several workers.

    Attributes:
        number: number of the worker, from 1.
        workers: number of workers.
    """

    number: int = 1
    workers: int = 1

    @classmethod
    def of(cls, text: str | None) -> ObjectShard:
        """Parse a shard: `2/8` is the second of eight workers, None the only one; raises UserError."""
        if text is None:
            return cls()
        found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text)
        number, workers = map(int, found.groups()) if found else (0, 0)
        if not 1 <= number <= workers:
            message = f"shard: expected NUMBER/WORKERS, such as 2/8, from 1/8 to 8/8; received {text!r}"
            raise UserError(message)
        return cls(number, workers)

    def holds(self, names: Iterable[str]) -> Mask:
        """Return whether each object belongs to this worker, (K,) bool, equal on all machines."""
        return np.array([_hash(name) % self.workers == self.number - 1 for name in names], dtype=bool)

    def starts(self, names: Sequence[str], belief: Belief, times: Tensor) -> tuple[list[str], Belief, Tensor]:
        """Return names, beliefs and times (N,) of the worker's objects; raises UserError if it has none."""
        own = torch.from_numpy(self.holds(names))
        if not own.any():
            received = f"none for worker {self.number} of {self.workers}"
            message = (
                f"shard: expected at least one of the {len(names)} objects in the start; received {received}"
            )
            raise UserError(message)
        mine = [name for name, is_own in zip(names, own.tolist(), strict=True) if is_own]
        return mine, Belief(belief.mean[own], belief.chol[own]), times[own]

    def lines(self, parsed: ParsedLines) -> ParsedLines:
        """Return the readings of this worker's objects; each invalid line is reported by one worker only."""
        if self.workers == 1:
            return parsed
        objects, times, sensors, values, deviations = parsed.table
        own = np.flatnonzero(self.holds(objects))
        columns = times[own], sensors[own], values[own], deviations[own]
        table = ReadingTable([objects[k] for k in own], *columns)
        bad = {line: why for line, why in parsed.bad.items() if line % self.workers == self.number - 1}
        return ParsedLines([parsed.lines[k] for k in own], table, bad)


def _hash(name: str) -> int:
    return int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest())
