"""Batches of windows in an order that depends on (seed, epoch) alone, resumable inside an epoch."""

from __future__ import annotations

from collections.abc import Iterator

import torch

from ahnn.data.windows import Windows
from ahnn.types import Window


class WindowLoader:
    """An iterable of window batches that Lightning can shuffle by epoch, checkpoint and resume.

    Args:
        windows: what to draw from.
        batch_size: windows in a batch; the last batch of an epoch may be smaller.
        per_epoch: windows drawn in one epoch, all of them if None.
        seed: makes the order, together with the epoch; None keeps the stored order, evenly thinned.
        emphasis: 0 draws all windows alike, without replacement; above, windows are drawn with replacement
            in proportion to this power of the speed at which their momenta change.
        rank, world: of `world` processes, this one gets part `rank` of every batch. All parts together are
            the batch of a single process, whatever the number of processes.
    """

    def __init__(
        self,
        windows: Windows,
        batch_size: int,
        per_epoch: int | None,
        seed: int | None,
        emphasis: float = 0.0,
        rank: int = 0,
        world: int = 1,
    ) -> None:
        self.windows = windows
        self.rank, self.world = rank, world
        self.batch_size = batch_size
        self.count = min(per_epoch or len(windows), len(windows))
        self.seed = seed
        self._cumulative = windows.speeds().pow(emphasis).cumsum(0).cpu() if emphasis else None
        self.epoch = 0
        self.position = 0
        self.resume_epoch: int | None = None

    @property
    def sampler(self) -> WindowLoader:
        """Lightning calls `sampler.set_epoch` before each epoch."""
        return self

    @property
    def batch_sampler(self) -> None:
        """Lightning asks whether batches are drawn by a sampler of their own; they are not."""
        return

    def set_epoch(self, epoch: int) -> None:
        """Choose the order of this epoch."""
        self.epoch = epoch

    def state_dict(self) -> dict[str, int]:
        """Return the place in the current epoch, for a checkpoint."""
        return {"epoch": self.epoch, "position": self.position}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Continue, in the epoch of the checkpoint, at the batch after the last one used."""
        self.resume_epoch, self.position = state["epoch"], state["position"]

    def __len__(self) -> int:
        """Return the number of batches of a whole epoch."""
        return -(-self.count // self.batch_size)

    def order(self) -> torch.Tensor:
        """Return the window indices of the current epoch, shape (count,)."""
        total = len(self.windows)
        if self.seed is None:
            return torch.arange(self.count) * total // self.count
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + self.epoch)
        if self._cumulative is None:
            return torch.randperm(total, generator=generator)[: self.count]
        draws = torch.rand(self.count, generator=generator, dtype=torch.float64) * self._cumulative[-1]
        return torch.searchsorted(self._cumulative, draws).clamp(max=total - 1)

    def __iter__(self) -> Iterator[Window]:
        """Yield the batches that are left of the current epoch."""
        begin = self.position if self.epoch == self.resume_epoch and self.position < len(self) else 0
        batches = self.order().to(self.windows.flat.device).split(self.batch_size)
        for self.position in range(begin + 1, len(batches) + 1):
            yield self._part(batches[self.position - 1])
        self.position = 0

    def _part(self, batch: torch.Tensor) -> Window:
        """Return the windows of this process among those of a batch, shape (B,)."""
        own = batch.tensor_split(self.world)[self.rank]
        window = self.windows.gather(own if len(own) else batch[:1])
        return window._replace(weight=self.world * len(own) / len(batch))
