"""Evaluate a finished run again: `python -m ahnn.evaluate run=DIR plugins=ukf`.

A run directory is self-sufficient: its own config.yaml and checkpoints/best.ckpt are used; `pretrained=NAME`
makes one from weights that come with the package. Further overrides
change that configuration; `plugins=NAME` and `measurement=NAME` take groups of the library.
"""

from __future__ import annotations

import json
import logging
import sys
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from ahnn.arguments import nearest
from ahnn.config import dotted_keys, guard
from ahnn.errors import UserError
from ahnn.paths import conf_dir
from ahnn.pretrained import install
from ahnn.train import build_parts, build_plugins, check_settings

log = logging.getLogger("ahnn")

USAGE = "usage: python -m ahnn.evaluate run=DIR | pretrained=NAME [plugins=.] [measurement=.] [key=value]"


def evaluate(arguments: list[str]) -> float:
    """Evaluate the best weights of a run and write its results anew; return the validation loss.

    Raises:
        UserError: no such run, or an override that does not fit its configuration.
    """
    import torch

    from ahnn.evaluation.report import finish
    from ahnn.setup import quiet

    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    log.setLevel(logging.INFO)
    quiet()
    folder, cfg = run_config(arguments)
    check_settings(cfg)
    torch.set_num_threads(cfg.threads)
    data, model = build_parts(cfg)
    plugins = build_plugins(cfg, data.system)
    metrics = folder / "metrics.json"
    about: dict[str, Any] = json.loads(metrics.read_text()) if metrics.exists() else {}
    kept = ("seed", "training_seconds", "optimiser_steps", "parameters", "val_loss")
    about = {key: about[key] for key in kept if key in about}
    return finish(model, data, plugins, about, loggers=(), label=cfg.label, folder=folder, **cfg.evaluation)


def run_config(arguments: list[str]) -> tuple[Path, DictConfig]:
    """Return the folder of a run and its configuration with overrides applied."""
    pairs = dict(argument.split("=", 1) for argument in arguments if "=" in argument)
    if not pairs.keys() & {"run", "pretrained"} or len(pairs) != len(arguments):
        message = f"{USAGE}; received: {' '.join(arguments) or 'nothing'}"
        raise UserError(message)
    name = pairs.pop("pretrained", None)
    folder = Path(pairs.pop("run", f"runs/pretrained_{name}"))
    if name is not None:
        install(name, folder)
    path = folder / "config.yaml"
    if not path.is_file():
        message = f"run {folder}: expected a run folder with config.yaml; found none"
        raise UserError(message)
    cfg = OmegaConf.load(path)
    assert isinstance(cfg, DictConfig)
    cfg.folder = str(folder)
    groups = [f"{key}={pairs.pop(key)}" for key in ("plugins", "measurement") if key in pairs]
    if groups:
        cfg.plugins = composed_plugins(groups)
    for key, value in pairs.items():
        if key not in set(dotted_keys(cfg)):
            message = f"configuration: unknown key {key!r}{nearest(key, dotted_keys(cfg))}"
            raise UserError(message)
        OmegaConf.update(cfg, key, OmegaConf.create(f"v: {value}").v)
    return folder, cfg


def composed_plugins(groups: list[str]) -> DictConfig:
    """Return the configuration of the plugins that Hydra composes of these groups."""
    from hydra import compose, initialize_config_dir

    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        cfg = compose("train", [*groups, "folder=."])
    OmegaConf.resolve(cfg.plugins)
    return cfg.plugins


def main() -> None:
    """Entry point of `python -m ahnn.evaluate` and `ahnn-evaluate`."""
    sys.exit(guard(lambda: evaluate(sys.argv[1:])))


if __name__ == "__main__":
    main()
