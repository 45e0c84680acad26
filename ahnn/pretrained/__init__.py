"""Trained weights shipped with the package, with configuration and scores.

Each folder contains weights.safetensors, sufficient for use, and config.yaml and metrics.json of the training
run.
"""

from __future__ import annotations

from pathlib import Path

from ahnn.errors import UserError
from ahnn.stored import SAVED

HERE = Path(__file__).parent


def names() -> list[str]:
    """Return the names of the trained models."""
    return sorted(folder.name for folder in HERE.iterdir() if (folder / SAVED).is_file())


def shipped(name: str) -> Path:
    """Return the folder of a trained model in the package.

    Raises:
        UserError: unknown model.
    """
    if name not in names():
        message = f"pretrained: expected one of {', '.join(names())}; received {name!r}"
        raise UserError(message)
    return HERE / name
