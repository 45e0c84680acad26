"""One table over the jobs of a multirun, printed when the last one is done."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig
from rich.box import SIMPLE_HEAD
from rich.table import Table

from ahnn.evaluation.table import number, show


class SweepTable(Callback):
    """Collects metrics.json of every job folder of the sweep."""

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Print the table, jobs in order, a job without scores marked."""
        del kwargs
        folder = Path(config.hydra.sweep.dir)
        jobs = sorted((f for f in folder.iterdir() if f.name.isdigit()), key=lambda f: int(f.name))
        show(sweep_table(folder, jobs))


def sweep_table(folder: Path, jobs: list[Path]) -> Table:
    """Return the table over job folders: overrides, time, validation loss and scores from the true start."""
    table = Table(title=f"sweep {folder}", title_justify="left", title_style="bold", box=SIMPLE_HEAD)
    for head in ("job", "overrides"):
        table.add_column(head)
    for head in ("seconds", "val loss", "position", "velocity", "energy"):
        table.add_column(head, justify="right")
    for job in jobs:
        overrides = _overrides(job)
        try:
            metrics = json.loads((job / "metrics.json").read_text())
            row = next(r for r in metrics["rows"] if not r["floor"] and r["start"] == "true")
        except (OSError, ValueError, StopIteration):
            table.add_row(job.name, overrides, *["-"] * 4, "no scores", style="red")
            continue
        numbers = (metrics["training_seconds"], metrics["val_loss"])
        values = (*numbers, row["position"], row["velocity"], row["energy"])
        table.add_row(job.name, overrides, *(number(float(v)) for v in values))
    return table


def _overrides(job: Path) -> str:
    """Return the overrides of a job on one line."""
    path = job / ".hydra" / "overrides.yaml"
    return " ".join(line[2:] for line in path.read_text().splitlines()) if path.exists() else ""
