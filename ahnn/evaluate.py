"""Evaluate a finished run again: `python -m ahnn.evaluate run=DIR plugins=ukf`.

A run directory is self-sufficient: its own config.yaml and checkpoints/best.ckpt are used; `pretrained=NAME`
makes one from weights that come with the package. Further overrides change that configuration, as
metrics.json then says; `plugins=NAME` and `measurement=NAME` take groups of the library.
"""

from __future__ import annotations

import json
import logging
import sys
from pathlib import Path
from typing import Any

import yaml
from hydra.core.override_parser.types import OverrideType
from omegaconf import DictConfig, OmegaConf

from ahnn.arguments import nearest
from ahnn.cli.commandline import dotted_keys, parse
from ahnn.cli.entry import guard
from ahnn.cli.settings import check_settings
from ahnn.errors import UserError
from ahnn.paths import conf_dir
from ahnn.pretrained import install, shipped
from ahnn.train import build_parts, build_plugins

log = logging.getLogger("ahnn")

USAGE = "usage: python -m ahnn.evaluate run=DIR | pretrained=NAME [plugins=.] [measurement=.] [key=value]"
GROUPS = ("plugins", "measurement")
NODES = ("system", "model", "data", "optimizer", "trainer", "plugins", "evaluation")
KEYS = ("seed", "threads", "window", "label", "ckpt", "scheduler")
TRAINING = ("seed", "training_seconds", "optimiser_steps", "parameters", "val_loss")


def evaluate(arguments: list[str]) -> float:
    """Evaluate the best weights of a run and write its results anew; return the validation loss.

    Raises:
        UserError: no such run, or an override that does not fit its configuration.
    """
    import torch

    from ahnn.cli.setup import quiet
    from ahnn.evaluation.report import finish

    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    log.setLevel(logging.INFO)
    quiet()
    name, folder, overrides = request(arguments)
    source = folder if name is None else shipped(name)
    cfg = overridden(run_config(source), overrides)
    cfg.folder = str(folder)
    check_settings(cfg)
    torch.set_num_threads(cfg.threads)
    data, model = build_parts(cfg)
    plugins = build_plugins(cfg, data)
    about = training_numbers(source / "metrics.json")
    if overrides:
        about["overrides"] = overrides
    if name is not None:
        install(name, folder)
    return finish(model, data, plugins, about, loggers=(), label=cfg.label, folder=folder, **cfg.evaluation)


def request(arguments: list[str]) -> tuple[str | None, Path, list[str]]:
    """Return the name of a trained model of the package or None, the run folder, and the overrides.

    Raises:
        UserError: neither a run nor a trained model is named, or an argument is not of the form key=value.
    """
    pairs = dict(argument.split("=", 1) for argument in arguments if "=" in argument)
    if not pairs.keys() & {"run", "pretrained"} or not all("=" in argument for argument in arguments):
        message = f"{USAGE}; received: {' '.join(arguments) or 'nothing'}"
        raise UserError(message)
    name = pairs.get("pretrained")
    folder = Path(pairs.get("run", f"runs/pretrained_{name}"))
    return name, folder, [a for a in arguments if a.split("=", 1)[0] not in ("run", "pretrained")]


def run_config(folder: Path) -> DictConfig:
    """Return the configuration of a run; options that its plugins have got since then take their defaults.

    Raises:
        UserError: the folder has none, or it is damaged.
    """
    path = folder / "config.yaml"
    if not path.is_file():
        message = f"run {folder}: expected a run folder with config.yaml; found none"
        raise UserError(message)
    try:
        cfg = OmegaConf.create(path.read_text())
    except (yaml.YAMLError, ValueError) as error:
        message = f"{path}: expected the YAML of a run; received: {one_line(error)}"
        raise UserError(message) from error
    read = cfg if isinstance(cfg, DictConfig) else OmegaConf.create()
    missing = [key for key in NODES if not isinstance(read.get(key), DictConfig)]
    missing += [key for key in KEYS if key not in read]
    if missing:
        message = f"{path}: expected the configuration of a run; received one without {', '.join(missing)}"
        raise UserError(message)
    for name, node in read.plugins.items():
        if isinstance(node, DictConfig) and (conf_dir() / "plugins" / f"{name}.yaml").exists():
            read.plugins[name] = completed(node, composed_plugins([f"plugins={name}"]).get(name, node))
    return read


def completed(stored: DictConfig, fresh: DictConfig) -> DictConfig:
    """Return the options of a plugin with those that it has got since; there null meant the default."""
    if fresh.keys() <= stored.keys():
        return stored
    return OmegaConf.merge(fresh, {key: value for key, value in stored.items() if value is not None})  # pyright: ignore


def overridden(cfg: DictConfig, overrides: list[str]) -> DictConfig:
    """Return the configuration of a run with overrides: groups first and then keys, whatever their order.

    Raises:
        UserError: an override that is no value of a single key.
    """
    pairs = [parsed(text) for text in overrides]
    if groups := [f"{key}={name_of_option(key, value)}" for key, value in pairs if key in GROUPS]:
        cfg.plugins = composed_plugins(groups)
    for key, value in pairs:
        if key in GROUPS:
            continue
        if key not in (known := set(dotted_keys(cfg))):
            message = f"configuration: unknown key {key!r}{nearest(key, sorted(known))}"
            raise UserError(message)
        if "." not in key and isinstance(cfg[key], DictConfig):
            message = (
                f"configuration: {key}: expected a single key, {key}.KEY=VALUE; received {value!r}. A "
                f"finished run keeps its {key}; only the groups {' and '.join(GROUPS)} are chosen anew"
            )
            raise UserError(message)
        OmegaConf.update(cfg, key, value)
    return cfg


def parsed(text: str) -> tuple[str, Any]:
    """Return key and value of an override, written as for a training.

    Raises:
        UserError: it is something else.
    """
    override = parse(text)
    if override.type is not OverrideType.CHANGE or override.is_sweep_override():
        message = f"override {text!r}: expected key=value with one value; a finished run takes no other"
        raise UserError(message)
    return override.key_or_group, override.value()


def name_of_option(group: str, value: Any) -> str:
    """Return what is chosen of a group; null chooses none where a group has that.

    Raises:
        UserError: the value is no name.
    """
    if value is None and (conf_dir() / group / "none.yaml").exists():
        return "none"
    if not isinstance(value, str):
        message = f"configuration: {group}: expected the name of an option; received {value!r}"
        raise UserError(message)
    return value


def composed_plugins(groups: list[str]) -> DictConfig:
    """Return the configuration of the plugins that Hydra composes of these groups."""
    from hydra import compose, initialize_config_dir

    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        cfg = compose("train", [*groups, "folder=."])
    OmegaConf.resolve(cfg.plugins)
    return cfg.plugins


def training_numbers(metrics: Path) -> dict[str, Any]:
    """Return what metrics.json says of the training; nothing where there is no such file.

    Raises:
        UserError: the file is damaged.
    """
    if not metrics.exists():
        return {}
    try:
        content = json.loads(metrics.read_text())
    except ValueError as error:
        content = one_line(error)
    if not isinstance(content, dict):
        message = f"{metrics}: expected the scores of a run; received: {content}. Remove it: it is made anew"
        raise UserError(message)
    return {key: content[key] for key in TRAINING if key in content}


def one_line(error: Exception) -> str:
    """Return the message of an error on one line."""
    return " ".join(str(error).split())


def main() -> None:
    """Entry point of `python -m ahnn.evaluate` and `ahnn-evaluate`."""
    arguments = sys.argv[1:]
    asks = bool({"-h", "--help"} & {*arguments})
    sys.exit(guard(lambda: sys.stdout.write(f"{__doc__}\n{USAGE}\n") if asks else evaluate(arguments)))


if __name__ == "__main__":
    main()
