"""The one DataModule that all models share: trajectories in, batches of windows out."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import torch
from lightning import LightningDataModule

from ahnn.arguments import Count, Seed, Within, checked
from ahnn.data.loader import WindowLoader
from ahnn.data.sources import Source
from ahnn.data.splits import Split, SplitData
from ahnn.data.windows import Windows, require_span
from ahnn.memory import require_memory
from ahnn.statistics import Statistics
from ahnn.types import Trajectories


@checked
class WindowDataModule(LightningDataModule):
    """Sliding windows of whole trajectories, split by trajectory.

    Args:
        source: where the trajectories come from.
        split: fractions of train, val and test.
        window: W, steps of a window.
        batch_size: windows of an optimiser step.
        windows_per_epoch: windows drawn in each epoch, others each time; None takes all.
        emphasis: 0 draws training windows alike; above, up to 4, in proportion to this power of the speed at
            which their momenta change. On eccentric orbits most samples lie where little happens.
        val_windows: evenly spread windows of a validation; None takes all.
        precision: 32 or 64, bits of the batches.
        order_seed: of the order of the batches.
    """

    def __init__(
        self,
        source: Source,
        *,
        split: list[float],
        window: Count,
        batch_size: Count,
        windows_per_epoch: Count | None,
        emphasis: Annotated[float, Within(0, 4)],
        val_windows: Count | None,
        precision: Literal[32, 64],
        order_seed: Seed,
    ) -> None:
        super().__init__()
        self.source = source
        self.splits = SplitData(source, split)
        self.window, self.span, self.batch_size = window, window, batch_size
        self.windows_per_epoch, self.val_windows = windows_per_epoch, val_windows
        self.dtype = {32: torch.float32, 64: torch.float64}[precision]
        self.emphasis, self.order_seed = emphasis, order_seed

    def require_span(self, steps: int) -> None:
        """Let training windows span at least so many steps: derivatives need more than W.

        Raises:
            UserError: the trajectories, as far as their length is known before they are made, are shorter.
        """
        self.span = max(self.window, steps)
        truth: Any = self.source.truth
        if truth is not None and getattr(truth, "periods", None) is None:
            require_span(self.span, truth.steps)

    def trajectories(self, split: Split) -> Trajectories:
        """Return the whole trajectories of a split."""
        return self.splits[split]

    def statistics(self) -> Statistics:
        """Return the statistics of the training split, float64."""
        return Statistics.of(self.trajectories("train"))

    def train_dataloader(self) -> WindowLoader:
        """Return shuffled training batches."""
        return self._loader("train", self.span, self.windows_per_epoch, self.order_seed, self.emphasis)

    def val_dataloader(self) -> WindowLoader:
        """Return the validation batches, the same in every epoch."""
        return self._loader("val", self.window, self.val_windows, None)

    def transfer_batch_to_device(self, batch: Any, device: torch.device, dataloader_idx: int) -> Any:
        """Return the batch as it is: windows are gathered on the device."""
        del device, dataloader_idx
        return batch

    def _loader(
        self, split: Split, span: int, limit: int | None, seed: int | None, emphasis: float = 0.0
    ) -> WindowLoader:
        windows = Windows(self.trajectories(split), span, self.dtype)
        size = 16.0 * min(self.batch_size, len(windows)) * (span + 1) * windows.flat.shape[-1]
        require_memory("data.batch_size", "the windows of a batch", size)
        if self.trainer is None:
            return WindowLoader(windows, self.batch_size, limit, seed, emphasis)
        windows.to(self.trainer.strategy.root_device)
        place = self.trainer.global_rank, self.trainer.world_size
        return WindowLoader(windows, self.batch_size, limit, seed, emphasis, *place)
