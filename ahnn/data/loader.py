"""Batch loaders with an order determined by (seed, epoch), resumable within an epoch."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ahnn.data.segments import Segments
from ahnn.data.windows import Windows
from ahnn.measurements import Segment
from ahnn.types import Window

CPU = torch.device("cpu")
AHEAD = 4
"""Number of batches gathered at once when streaming."""
PERMUTED = 10**8
"""Number of windows up to which an epoch is drawn from a full permutation."""


class EpochLoader(ABC):
    """Iterable of batches that Lightning can shuffle by epoch, checkpoint and resume."""

    def __init__(self) -> None:
        self.epoch = 0
        self.position = 0
        self.resume_epoch: int | None = None

    @property
    def streamed(self) -> bool:
        """Whether batches are gathered ahead of time, in the background."""
        return False

    @property
    def sampler(self) -> EpochLoader:
        """This object, since Lightning calls `sampler.set_epoch` before each epoch."""
        return self

    @property
    def batch_sampler(self) -> None:
        """None: Lightning queries a batch sampler, but there is no separate one."""
        return

    def set_epoch(self, epoch: int) -> None:
        """Set the epoch, which determines the order."""
        self.epoch = epoch

    def state_dict(self) -> dict[str, int]:
        """Return the position in the current epoch, for a checkpoint."""
        return {"epoch": self.epoch, "position": self.position}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Continue, in the epoch of the checkpoint, at the batch after the last one used."""
        self.resume_epoch, self.position = state["epoch"], state["position"]

    @abstractmethod
    def __len__(self) -> int:
        """Return the number of batches in an epoch."""

    @abstractmethod
    def batches(self) -> Sequence[Tensor]:
        """Return the indices of each batch of the current epoch."""

    @abstractmethod
    def gather(self, batch: Tensor) -> Any:
        """Return the batch of given indices."""

    def __iter__(self) -> Iterator[Any]:
        """Yield the remaining batches of the current epoch."""
        begin = self.position if self.epoch == self.resume_epoch and self.position < len(self) else 0
        batches = self.batches()[begin:]
        gathered = ahead(self.gather, batches) if self.streamed else map(self.gather, batches)
        for self.position, batch in enumerate(gathered, begin + 1):
            yield batch
        self.position = 0


def ahead(gather: Callable[[Tensor], Any], batches: Sequence[Tensor]) -> Iterator[Any]:
    """Yield gathered batches, with the next ones gathered in the background."""
    pool = ThreadPoolExecutor(AHEAD)
    try:
        coming = deque(pool.submit(gather, batch) for batch in batches[:AHEAD])
        for number in range(len(batches)):
            done = coming.popleft().result()
            if number + AHEAD < len(batches):
                coming.append(pool.submit(gather, batches[number + AHEAD]))
            yield done
    finally:
        pool.shutdown(cancel_futures=True)


class WindowLoader(EpochLoader):
    """Batches of windows.

    Args:
        windows: windows to draw from.
        batch_size: windows in a batch; the last batch of an epoch may be smaller.
        per_epoch: windows drawn per epoch, or None for all.
        seed: seed of the order, together with the epoch; None for the stored order, evenly thinned.
        emphasis: 0 for uniform draws without replacement; otherwise draws with replacement in proportion to
            this power of the rate of momentum change.
        rank, world: this process gets part `rank` of `world` parts of every batch. Together the parts equal
            the batch of a single process, for any number of processes.
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
        super().__init__()
        self.windows = windows
        self.rank, self.world = rank, world
        self.batch_size = batch_size
        self.count = min(per_epoch or len(windows), len(windows))
        self.seed = seed
        self._cumulative = windows.speeds().pow(emphasis).cumsum(0).cpu() if emphasis else None

    @property
    def streamed(self) -> bool:
        """Whether batches may wait for a disk."""
        return self.windows.streamed

    def __len__(self) -> int:
        """Return the number of batches in an epoch."""
        return -(-self.count // self.batch_size)

    def order(self) -> torch.Tensor:
        """Return the window indices of the current epoch, shape (count,)."""
        total = len(self.windows)
        if self.seed is None:
            return torch.arange(self.count) * total // self.count
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + self.epoch)
        if self._cumulative is None and total > PERMUTED and self.count < total // 2:
            return distinct(total, self.count, generator)
        if self._cumulative is None:
            return torch.randperm(total, generator=generator)[: self.count]
        draws = torch.rand(self.count, generator=generator, dtype=torch.float64) * self._cumulative[-1]
        return torch.searchsorted(self._cumulative, draws).clamp(max=total - 1)

    def batches(self) -> Sequence[Tensor]:
        """Return the window indices of each batch of the current epoch."""
        return self.order().to(self.windows.flat.device).split(self.batch_size)

    def gather(self, batch: Tensor) -> Window:
        """Return this process's part of the windows of a batch, shape (B,)."""
        own = batch.tensor_split(self.world)[self.rank]
        window = self.windows.gather(own if len(own) else batch[:1])
        return window._replace(weight=self.world * len(own) / len(batch))


def distinct(total: int, count: int, generator: torch.Generator) -> Tensor:
    """Draw `count` distinct numbers below `total`, in random order, without a full permutation."""
    drawn = torch.empty(0, dtype=torch.int64)
    while len(drawn) < count:
        more = torch.randint(total, (2 * (count - len(drawn)),), generator=generator)
        drawn = torch.cat((drawn, more))
        _, first = np.unique(drawn.numpy(), return_index=True)
        drawn = drawn[torch.from_numpy(np.sort(first))]
    return drawn[:count]


class SegmentLoader(EpochLoader):
    """Batches of measurement segments, redrawn for each step.

    Args:
        segments: function from the epoch to the segments and the batch size.
        steps: batches per epoch; 0 for each segment once, in the stored order.
        seed: seed of the draws, together with the epoch.
        device: device of the batches.
    """

    def __init__(
        self,
        segments: Callable[[int], tuple[Segments, int]],
        steps: int,
        seed: int,
        device: torch.device = CPU,
    ) -> None:
        super().__init__()
        self.segments, self.steps, self.seed, self.device = segments, steps, seed, device

    def __len__(self) -> int:
        """Return the number of batches of an epoch."""
        segments, size = self.segments(self.epoch)
        return self.steps or -(-len(segments) // size)

    def batches(self) -> Sequence[Tensor]:
        """Return the indices of each batch of the current epoch."""
        segments, size = self.segments(self.epoch)
        count = len(segments)
        if not self.steps:
            return torch.arange(count).split(size)
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + self.epoch)
        return [torch.randperm(count, generator=generator)[:size] for _ in range(self.steps)]

    def gather(self, batch: Tensor) -> Segment:
        """Return the segments of a batch, on the device."""
        return self.segments(self.epoch)[0].gather(batch).to(self.device)
