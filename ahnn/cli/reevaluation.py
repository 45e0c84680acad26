"""Configuration of a re-evaluation: the configuration of the finished run, with few permitted changes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from omegaconf import DictConfig, OmegaConf

from ahnn.arguments import flatten, nearest
from ahnn.cli.files_of_run import from_its_folder
from ahnn.cli.importing import let_import
from ahnn.cli.pairs import read_pairs
from ahnn.cli.parts import SENSOR, SIMULATION
from ahnn.cli.settings import check_again
from ahnn.cli.trust import require_trusted, targets
from ahnn.cli.unreferenced_keys import require_referenced
from ahnn.contents import read_plain
from ahnn.errors import UserError, WrongUsage
from ahnn.paths import cache_dir
from ahnn.pretrained import shipped
from ahnn.stored import SAVED

OWN = ("run", "pretrained", "ckpt", "name")
"""Keys of `Own`."""
GROUPS = ("plugins", "measurement")
NODES = ("system", "data", "evaluation", "plugins", "measurement")
"""Parts of a configuration used by an evaluation."""
KEYS = ("label", "threads")
SINCE = {"bias_sd": None, "bias_memory": None}
"""Keys of `measurement` that runs of version 0.2 lack."""
DATA = (*SIMULATION, "split", *SENSOR)
"""Keys of `data` that define trajectories and sensor, not the training; the cache is the current user's."""


@dataclass(frozen=True, kw_only=True)
class Own:
    """Keys of the command line that are not part of the configuration."""

    run: str | None = None
    pretrained: str | None = None
    ckpt: str = "best"
    name: str | None = None


class Request(NamedTuple):
    """Request of a command line.

    Attributes:
        source: run folder or name of a shipped model.
        folder: folder of its evaluations.
        ckpt: weights to evaluate.
        name: name of the evaluation, or None.
        overrides: key=value, in the order given.
        trust: whether to build any class that the run's configuration names.
    """

    source: Path
    folder: Path
    ckpt: str
    name: str | None
    overrides: list[str]
    trust: bool

    @classmethod
    def of(cls, arguments: list[str]) -> Request:
        """Parse the request of a command line.

        Raises:
            UserError: neither a run nor a shipped model is named, or an argument is not key=value.
        """
        given = [text for text in arguments if text != "--trust"]
        if not any(text.startswith(("run=", "pretrained=")) for text in given) or not all(
            "=" in text for text in given
        ):
            message = f"received: {' '.join(arguments) or 'nothing'}"
            raise WrongUsage(message)
        mine = [text for text in given if text.partition("=")[0] in OWN]
        own = read_pairs(mine, Own)
        name = own.pretrained
        folder = Path(f"runs/pretrained_{name}" if own.run is None else own.run)
        if name is not None and (folder / "config.yaml").exists():
            message = (
                f"run {folder}: expected a folder for pretrained={name}; received a different run. Name a "
                "new folder"
            )
            raise UserError(message)
        overrides = [text for text in given if text not in mine]
        source = folder if name is None else shipped(name)
        trust = len(given) < len(arguments)
        return cls(source, folder, own.ckpt, own.name, overrides, trust)


def run_config(folder: Path, request: Request) -> DictConfig:
    """Return the configuration of a run with the requested changes.

    Raises:
        UserError: the configuration is missing or damaged or names untrusted classes, or an override has no
            effect or a wrong value.
    """
    path = folder / "config.yaml"
    if (folder / SAVED).exists() and not path.exists():
        message = (
            f"run={folder}: expected a run with its data; received a model written by ahnn.save, which "
            "ahnn.predict, ahnn.assimilate and ahnn.export accept. ahnn.fit trains and evaluates on tensors"
        )
        raise UserError(message)
    content = read_plain(path)
    missing = [key for key in NODES if not isinstance(content.get(key), dict)]
    missing += [key for key in KEYS if key not in content]
    if missing:
        message = f"{path}: expected the configuration of a run; received one without {', '.join(missing)}"
        raise UserError(message)
    content["measurement"] = {**SINCE, **content["measurement"]}
    content["data"] = {key: content["data"].get(key) for key in DATA} | {"cache": str(cache_dir())}
    if request.trust:
        let_import(targets(content))
    else:
        require_trusted(path, content, (*NODES, *KEYS))
    content["system"] = from_its_folder(content["system"], folder)
    cfg = OmegaConf.create({key: content[key] for key in (*NODES, *KEYS)})
    cfg = chosen_again(cfg, request.overrides) if request.overrides else cfg
    check_again(cfg)
    return cfg


def chosen_again(cfg: DictConfig, texts: list[str]) -> DictConfig:
    """Return the configuration of a run with overrides, group options first.

    Raises:
        UserError: an override is not key=value, names an unknown option, or has no effect on a finished run.
    """
    from ahnn.cli.commandline import pair
    from ahnn.cli.compose import composed

    pairs = dict(map(pair, texts))
    if groups := [text for text in texts if pair(text)[0] in GROUPS]:
        anew = composed("train", groups, partly=True)
        for group in pairs.keys() & GROUPS:
            cfg[group] = anew[group]
    known: Any = flatten(OmegaConf.to_container(cfg))  # pyright: ignore[reportArgumentType]
    for key, value in pairs.items():
        if key in known:
            OmegaConf.update(cfg, key, value)
        elif key not in GROUPS:
            hint = nearest(key, [*known, *GROUPS])
            message = f"{key}: expected a key that applies to a finished run, not to its training{hint}"
            raise UserError(message)
    require_referenced([cfg], texts)
    return cfg
