"""Training, validation and test: whole trajectories, divided once for all models."""

from __future__ import annotations

from typing import Literal

from ahnn.data.sources import Source
from ahnn.errors import UserError
from ahnn.types import Trajectories

Split = Literal["train", "val", "test"]
SPLITS: tuple[Split, ...] = ("train", "val", "test")


class SplitData:
    """The trajectories of a source in three splits, read when they are first asked for.

    Args:
        source: where they come from.
        split: shares of train, val and test.
    """

    def __init__(self, source: Source, split: list[float]) -> None:
        self.source = source
        self.shares = split
        check_shares(split)
        self._parts: dict[Split, Trajectories] = {}

    def __getitem__(self, split: Split) -> Trajectories:
        """Return the whole trajectories of a split."""
        if not self._parts:
            data = self.source.read()
            begin = 0
            for name, size in zip(SPLITS, split_sizes(len(data.states), self.shares), strict=True):
                self._parts[name] = data.part(slice(begin, begin + size))
                begin += size
        return self._parts[split]


def check_shares(shares: list[float]) -> None:
    """Raise UserError for shares that are not three positive numbers of sum 1."""
    if not (len(shares) == 3 and all(s > 0 for s in shares) and abs(sum(shares) - 1) <= 1e-9):
        message = f"split: expected three positive shares of sum 1 (train, val, test); received {shares}"
        raise UserError(message)


def split_sizes(count: int, shares: list[float]) -> list[int]:
    """Return how many trajectories each split gets; the first takes what rounding leaves.

    Raises:
        UserError: shares that are not three positive numbers of sum 1, or a split that stays empty.
    """
    check_shares(shares)
    rest = [round(share * count) for share in shares[1:]]
    sizes = [count - sum(rest), *rest]
    if min(sizes) < 1:
        named = ", ".join(f"{name} {size}" for name, size in zip(SPLITS, sizes, strict=True))
        message = (
            f"split: expected at least one trajectory in each; received {count} trajectories with shares "
            f"{shares}, which makes {named}. Ask for more trajectories"
        )
        raise UserError(message)
    return sizes
