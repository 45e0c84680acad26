"""What Hydra calls when the last job of a multirun is done."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig


class SweepTable(Callback):
    """Collects the results in every job folder of the sweep."""

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Print the table, jobs in order, a job without results marked; folders with names have another."""
        del kwargs
        from ahnn.evaluation.over_jobs import sweep_table
        from ahnn.evaluation.terminal import show

        folder = Path(config.hydra.sweep.dir)
        jobs = sorted((f for f in folder.iterdir() if f.name.isdigit()), key=lambda f: int(f.name))
        if jobs:
            show(sweep_table(folder, jobs))
