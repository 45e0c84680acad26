"""The graphs of a trained model in a folder, for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ahnn.evaluation.terminal import show
from ahnn.graphs import write_export
from ahnn.jobs.named import named_runs


@dataclass(frozen=True, kw_only=True)
class ExportRequest:
    """The keys of `python -m ahnn.export`, whose help says what they are."""

    output: str
    run: str | None = None
    pretrained: str | None = None
    ckpt: str = "best"


def export(asked: ExportRequest) -> None:
    """Write the graphs of a run into a new folder.

    Raises:
        UserError: no such run, one that has no graph, or a folder that exists.
    """
    (run,) = named_runs(asked.run, asked.pretrained, asked.ckpt)
    files = write_export(run, Path(asked.output))
    show(f"{run.folder.name}: {', '.join(files)} in {asked.output}")
