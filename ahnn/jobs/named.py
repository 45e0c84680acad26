"""Loading of the runs named by a command: folders or a shipped model."""

from __future__ import annotations

from pathlib import Path

from ahnn.ensembles import require_same_states
from ahnn.errors import UserError
from ahnn.loading import load, member_folders
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
    require_same_states(runs)
    return runs


def opened(run: str | list[str] | None) -> str | list[str] | None:
    """Replace the folders of ensembles among run folders by the folders of their members."""
    if run is None:
        return None
    given = run if isinstance(run, list) else [run]
    found = [str(one) for folder in given for one in member_folders(Path(folder)) or [folder]]
    return found if len(found) > 1 else found[0]
