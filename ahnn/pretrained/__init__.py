"""Trained weights shipped with the package, with configuration and scores.

Each folder contains weights.safetensors, sufficient for use, and config.yaml and metrics.json of the training
run.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import yaml

from ahnn.checkpoints import read_weights, write_weights
from ahnn.contents import read_plain
from ahnn.errors import UserError
from ahnn.stored import SAVED

HERE = Path(__file__).parent
MACHINE = ("callbacks", "logger", "run", "folder")
"""Parts of a configuration specific to the machine of a run."""


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


def pack(run: Path, name: str) -> Path:
    """Add the best weights of a run to the trained models and return their folder.

    Machine-specific folders are removed from the configuration.
    """
    folder = HERE / name
    folder.mkdir(exist_ok=True)
    write_weights(folder / SAVED, read_weights(run / "checkpoints" / "best.ckpt"))
    cfg = read_plain(run / "config.yaml")
    kept = {key: value for key, value in cfg.items() if key not in MACHINE}
    (folder / "config.yaml").write_text(yaml.safe_dump(kept, sort_keys=False))
    shutil.copyfile(run / "metrics.json", folder / "metrics.json")
    return folder
