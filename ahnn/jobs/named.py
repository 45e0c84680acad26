"""Loading of the runs named by a command: folders or a shipped model."""

from __future__ import annotations

from ahnn.errors import UserError
from ahnn.loading import load
from ahnn.pretrained import shipped
from ahnn.runs import Run


def named_runs(run: str | list[str] | None, pretrained: str | None, ckpt: str) -> list[Run]:
    """Load the runs, or the shipped model, named by a command.

    Raises:
        UserError: neither or both are named, a run is missing, or their states differ.
    """
    if (not run and pretrained is None) or (run and pretrained is not None):
        message = f"run: expected run=DIR or pretrained=NAME; received {'both' if run else 'neither'}"
        raise UserError(message)
    folders = [shipped(pretrained)] if pretrained is not None else run if isinstance(run, list) else [run]
    runs = [load(str(folder), ckpt) for folder in folders]
    first = runs[0].space._replace(name="")
    for other in runs[1:]:
        if (space := other.space._replace(name="")) != first:
            message = f"run: expected runs of the same states and units; received {first} and {space}"
            raise UserError(message)
    return runs
