"""Trained weights that come with the package, each with its configuration and its scores.

`python -m ahnn.evaluate pretrained=molniya_central_body` evaluates one without training. A folder here holds
config.yaml and metrics.json of the run, and its best weights as safetensors.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from ahnn.arguments import nearest
from ahnn.checkpoints import read_checkpoint
from ahnn.errors import UserError

HERE = Path(__file__).parent
MACHINE = ("callbacks", "logger", "run", "folder")
FILES = ("config.yaml", "metrics.json", "weights.safetensors")


class Weights(NamedTuple):
    """The best weights of a run.

    Attributes:
        state: by name of the parameter or buffer.
        model: arguments of the model that they belong to.
        loss: their validation loss, where it is known.
    """

    state: dict[str, Tensor]
    model: dict[str, Any]
    loss: float | None


def names() -> list[str]:
    """Return the names of the trained models."""
    return sorted(folder.name for folder in HERE.iterdir() if (folder / "weights.safetensors").is_file())


def shipped(name: str) -> Path:
    """Return the folder of a trained model in the package.

    Raises:
        UserError: no model of this name.
    """
    if name not in names():
        message = f"pretrained: no model {name!r}{nearest(name, names())}"
        raise UserError(message)
    return HERE / name


def install(name: str, folder: Path) -> None:
    """Make a run folder from a trained model, or make one from the same model whole again.

    Raises:
        UserError: no model of this name, or the folder holds another run.
    """
    source, config = shipped(name), folder / "config.yaml"
    same = not config.exists() or config.read_bytes() == (source / "config.yaml").read_bytes()
    if not same or (folder / "checkpoints").exists():
        message = (
            f"pretrained {name}: expected a folder of its own; received {folder}, which holds another run. "
            "Name a new folder with run=DIR"
        )
        raise UserError(message)
    folder.mkdir(parents=True, exist_ok=True)
    for file in FILES:
        shutil.copyfile(source / file, folder / file)


def pack(run: Path, name: str) -> Path:
    """Put the best weights of a run among the trained models and return their folder.

    What belongs to the machine of the run, its folders, is left out of the configuration.
    """
    folder = HERE / name
    folder.mkdir(exist_ok=True)
    state = best_weights(run).state
    save_file({key: value.contiguous() for key, value in state.items()}, folder / "weights.safetensors")
    cfg = yaml.safe_load((run / "config.yaml").read_text())
    cfg["data"]["cache"] = "~/.cache/ahnn"
    kept = {key: value for key, value in cfg.items() if key not in MACHINE}
    (folder / "config.yaml").write_text(yaml.safe_dump(kept, sort_keys=False))
    shutil.copyfile(run / "metrics.json", folder / "metrics.json")
    return folder


def best_weights(run: Path) -> Weights:
    """Return the best weights of a run folder.

    Raises:
        UserError: the folder has no intact weights.
    """
    path = run / "weights.safetensors"
    if not path.is_file() or (run / "checkpoints" / "best.ckpt").exists():
        best = read_checkpoint(run / "checkpoints" / "best.ckpt")
        return Weights(best["state_dict"], dict(best["hyper_parameters"]), best["ahnn"]["val_loss"])
    try:
        state = load_file(path)
    except SafetensorError as error:
        message = (
            f"weights {path}: expected an intact safetensors file; received a damaged one ({error}). "
            "Install the package again"
        )
        raise UserError(message) from error
    model = yaml.safe_load((run / "config.yaml").read_text())["model"]
    return Weights(state, {key: value for key, value in model.items() if key != "_target_"}, None)
