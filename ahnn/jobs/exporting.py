"""Export of a trained model's graphs to a folder, for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ahnn.evaluation.terminal import show
from ahnn.graphs import write_export
from ahnn.jobs.named import named_runs
from ahnn.loading import unfinished_training, warn_once


@dataclass(frozen=True, kw_only=True)
class ExportRequest:
    """Options of `python -m ahnn.export`, described in its help."""

    output: str
    run: str | None = None
    pretrained: str | None = None
    ckpt: str = "best"


def export(asked: ExportRequest) -> None:
    """Write the graphs of a run into a new folder.

    Raises:
        UserError: a missing run, one that cannot be exported, or an existing folder.
    """
    (run,) = named_runs(asked.run, asked.pretrained, asked.ckpt)
    if remark := unfinished_training(run.folder):
        warn_once(remark)
    files = write_export(run, Path(asked.output))
    show(f"{run.folder.name}: {', '.join(files)} in {asked.output}")
