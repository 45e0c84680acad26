"""Concatenated batches of several training runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from ahnn.data.loader import EpochLoader


class GroupedLoader(EpochLoader):
    """Batches of E B rows: the first B are the batch of the first training run, and so on.

    Args:
        loaders: loaders of the same data, which differ in their order.
    """

    def __init__(self, loaders: Sequence[EpochLoader]) -> None:
        super().__init__()
        self.loaders = [*loaders]

    @property
    def streamed(self) -> bool:
        """Whether batches are gathered ahead of time, in the background."""
        return self.loaders[0].streamed

    def set_epoch(self, epoch: int) -> None:
        """Set the epoch of all loaders."""
        super().set_epoch(epoch)
        for loader in self.loaders:
            loader.set_epoch(epoch)

    def __len__(self) -> int:
        """Return the number of batches of a whole epoch."""
        return len(self.loaders[0])

    def batches(self) -> Sequence[Tensor]:
        """Return the indices of each batch of the current epoch."""
        orders = (loader.batches() for loader in self.loaders)
        return [torch.cat(parts) for parts in zip(*orders, strict=True)]

    def gather(self, batch: Tensor) -> Any:
        """Return the samples of given indices as one batch."""
        return self.loaders[0].gather(batch)
