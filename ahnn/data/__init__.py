"""Data pipeline: sources, generation, storage, splits and sliding windows.

Only `WindowDataModule` requires Lightning, so it is imported from its own module.
"""

from __future__ import annotations

from ahnn.data.files import Files
from ahnn.data.sources import Given, Simulated, Source
from ahnn.data.splits import SPLITS, Split, SplitData

__all__ = ["SPLITS", "Files", "Given", "Simulated", "Source", "Split", "SplitData"]
