"""Hydra callback that tabulates the results of a multirun."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig

from ahnn.manifest import digest_of, record

FILE = "multirun.yaml"


class SweepTable(Callback):
    """Collects the results of all job folders of a sweep."""

    def on_job_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Record the file written by Hydra before the first job."""
        file = Path(config.hydra.sweep.dir) / FILE
        if config.hydra.mode == RunMode.MULTIRUN and file.is_file():
            record(file, digest_of(file.read_bytes()))

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Print the table of numbered job folders in job order, marking jobs without results."""
        from ahnn.evaluation.sweep_summary import sweep_table
        from ahnn.evaluation.terminal import show

        folder = Path(config.hydra.sweep.dir)
        jobs = sorted((f for f in folder.iterdir() if f.name.isdigit()), key=lambda f: int(f.name))
        if jobs:
            show(sweep_table(folder, jobs))
