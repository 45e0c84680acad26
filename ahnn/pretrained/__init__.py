"""Trained weights that come with the package, each with its configuration and its scores.

`python -m ahnn.evaluate pretrained=molniya_central_body` evaluates one without training. A folder here holds
config.yaml and metrics.json of the run, and its best weights as safetensors.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import yaml
from safetensors.torch import load_file, save_file
from torch import Tensor

from ahnn.arguments import nearest
from ahnn.checkpoints import read_checkpoint
from ahnn.errors import UserError

HERE = Path(__file__).parent
MACHINE = ("callbacks", "logger", "run", "folder")
FILES = ("config.yaml", "metrics.json", "weights.safetensors")


def names() -> list[str]:
    """Return the names of the trained models."""
    return sorted(folder.name for folder in HERE.iterdir() if (folder / "weights.safetensors").is_file())


def install(name: str, folder: Path) -> None:
    """Make a run folder from a trained model.

    Raises:
        UserError: no model of this name.
    """
    if name not in names():
        message = f"pretrained: no model {name!r}{nearest(name, names())}"
        raise UserError(message)
    folder.mkdir(parents=True, exist_ok=True)
    for file in FILES:
        shutil.copyfile(HERE / name / file, folder / file)


def pack(run: Path, name: str) -> Path:
    """Put the best weights of a run among the trained models and return their folder.

    What belongs to the machine of the run, its folders, is left out of the configuration.
    """
    folder = HERE / name
    folder.mkdir(exist_ok=True)
    weights, _ = best_weights(run)
    save_file({key: value.contiguous() for key, value in weights.items()}, folder / "weights.safetensors")
    cfg = yaml.safe_load((run / "config.yaml").read_text())
    cfg["data"]["cache"] = "~/.cache/ahnn"
    kept = {key: value for key, value in cfg.items() if key not in MACHINE}
    (folder / "config.yaml").write_text(yaml.safe_dump(kept, sort_keys=False))
    shutil.copyfile(run / "metrics.json", folder / "metrics.json")
    return folder


def best_weights(run: Path) -> tuple[dict[str, Tensor], float | None]:
    """Return the best weights of a run folder, and their validation loss where it is known.

    Raises:
        UserError: the folder has no intact weights.
    """
    shipped = run / "weights.safetensors"
    if shipped.is_file() and not (run / "checkpoints" / "best.ckpt").exists():
        return load_file(shipped), None
    best = read_checkpoint(run / "checkpoints" / "best.ckpt")
    return best["state_dict"], best["ahnn"]["val_loss"]
