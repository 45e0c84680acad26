"""The one DataModule that all models share: trajectories in, batches of windows out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import torch
from lightning import LightningDataModule

from ahnn.arguments import Count, Seed, Within, checked
from ahnn.data import store
from ahnn.data.generate import generate
from ahnn.data.loader import WindowLoader
from ahnn.data.windows import Windows
from ahnn.dynamics.scaling import Statistics
from ahnn.errors import UserError
from ahnn.systems import System
from ahnn.types import Trajectories

Split = Literal["train", "val", "test"]
SPLITS: tuple[Split, ...] = ("train", "val", "test")


@checked
class WindowDataModule(LightningDataModule):
    """Sliding windows of generated trajectories, split by trajectory.

    Args:
        system: the ground truth.
        trajectories: number of trajectories, over all splits.
        split: shares of train, val and test.
        window: W, steps of a window.
        stencil: steps that a training window spans at least; derivatives need more than W.
        batch_size: windows of an optimiser step.
        windows_per_epoch: windows drawn anew in each epoch; None takes all.
        emphasis: 0 draws training windows alike; above, in proportion to this power of the speed at which
            their momenta change. On eccentric orbits most samples lie where little happens.
        val_windows: evenly spread windows of a validation; None takes all.
        precision: 32 or 64, bits of the batches.
        seed: of the initial states; the same for all models and training seeds.
        order_seed: of the order of the batches.
        cache: folder of generated data.
    """

    def __init__(
        self,
        system: System,
        *,
        trajectories: int,
        split: list[float],
        window: int,
        stencil: int,
        batch_size: Count,
        windows_per_epoch: Count | None,
        emphasis: Annotated[float, Within(0)],
        val_windows: Count | None,
        precision: Literal[32, 64],
        seed: Seed,
        order_seed: Seed,
        cache: str,
    ) -> None:
        super().__init__()
        self.system = system
        self.count = trajectories
        self.sizes = split_sizes(trajectories, split)
        self.window, self.stencil, self.batch_size = window, stencil, batch_size
        self.windows_per_epoch, self.val_windows = windows_per_epoch, val_windows
        self.dtype = {32: torch.float32, 64: torch.float64}[precision]
        self.emphasis = emphasis
        self.seed, self.order_seed = seed, order_seed
        self.cache = Path(cache).expanduser()
        self._splits: dict[Split, Trajectories] = {}
        self._check()

    def _check(self) -> None:
        if not 1 <= self.window <= self.system.steps and getattr(self.system, "periods", None) is None:
            message = (
                f"window: expected 1 <= W <= {self.system.steps}, the steps of a {self.system.name} "
                f"trajectory; received W={self.window}"
            )
            raise UserError(message)

    def setup(self, stage: str | None = None) -> None:
        """Load or generate the trajectories and split them; all stages share one data set."""
        del stage
        if self._splits:
            return
        wanted = store.recipe(self.system, self.count, self.seed)
        data = store.load_or_make(self.cache, wanted, lambda: generate(self.system, self.count, self.seed))
        states, lengths = data.states.split(self.sizes), data.lengths.split(self.sizes)
        for name, part, part_lengths in zip(SPLITS, states, lengths, strict=True):
            self._splits[name] = Trajectories(part, part_lengths, data.dt)

    def trajectories(self, split: Split) -> Trajectories:
        """Return the whole trajectories of a split."""
        self.setup()
        return self._splits[split]

    def statistics(self) -> Statistics:
        """Return the statistics of the training split, float64."""
        return Statistics.of(self.trajectories("train").states, self.system.dt)

    def train_dataloader(self) -> WindowLoader:
        """Return shuffled training batches."""
        span = max(self.window, self.stencil)
        return self._loader("train", span, self.windows_per_epoch, self.order_seed, self.emphasis)

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
        if self.trainer is None:
            return WindowLoader(windows, self.batch_size, limit, seed, emphasis)
        windows.to(self.trainer.strategy.root_device)
        place = self.trainer.global_rank, self.trainer.world_size
        return WindowLoader(windows, self.batch_size, limit, seed, emphasis, *place)


def split_sizes(count: int, shares: list[float]) -> list[int]:
    """Return how many trajectories each split gets; the first takes what rounding leaves.

    Raises:
        UserError: shares that are not three positive numbers of sum 1, or a split that stays empty.
    """
    if not (len(shares) == 3 and all(s > 0 for s in shares) and abs(sum(shares) - 1) <= 1e-9):
        message = (
            f"data: split: expected three positive shares of sum 1 (train, val, test); received {shares}"
        )
        raise UserError(message)
    rest = [round(share * count) for share in shares[1:]]
    sizes = [count - sum(rest), *rest]
    if min(sizes) < 1:
        named = ", ".join(f"{name} {size}" for name, size in zip(SPLITS, sizes, strict=True))
        message = (
            f"data: expected at least one trajectory in each split; received {count} trajectories with "
            f"shares {shares}, which makes {named}. Ask for more trajectories."
        )
        raise UserError(message)
    return sizes
