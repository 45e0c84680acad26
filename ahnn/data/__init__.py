"""From a system to batches: generation, storage, sliding windows, the DataModule."""

from __future__ import annotations

from ahnn.data.datamodule import SPLITS, Split, WindowDataModule

__all__ = ["SPLITS", "Split", "WindowDataModule"]
