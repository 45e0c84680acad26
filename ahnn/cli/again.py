"""What is asked of a finished run: its own configuration, and the few things that can be chosen again."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from omegaconf import DictConfig, OmegaConf

from ahnn.arguments import nearest
from ahnn.cli.trust import read_plain, require_trusted
from ahnn.data import SplitData
from ahnn.data.splits import split_sizes
from ahnn.errors import UserError
from ahnn.paths import conf_dir
from ahnn.pretrained import shipped
from ahnn.runs import Run

OWN = ("run", "pretrained", "ckpt", "name")
GROUPS = ("plugins", "measurement")
NODES = ("system", "data", "evaluation", "plugins", "measurement")
"""Parts of a configuration that an evaluation builds from."""
KEYS = ("label", "threads")
DATA = ("trajectories", "split", "seed", "cache")
"""Keys of `data` that say which trajectories there are; the others made the training."""


class Request(NamedTuple):
    """What a command line asks for.

    Attributes:
        source: run folder or name of a shipped model, what is loaded.
        folder: where its evaluations are kept.
        ckpt: the weights to evaluate.
        name: of the evaluation, or None.
        overrides: key=value, in the order given.
        trust: whether to build whatever the run's configuration names.
    """

    source: Path
    folder: Path
    ckpt: str
    name: str | None
    overrides: list[str]
    trust: bool

    @classmethod
    def of(cls, arguments: list[str], usage: str) -> Request:
        """Return the request of a command line.

        Raises:
            UserError: neither a run nor a shipped model is named, or an argument is not key=value.
        """
        given = [argument for argument in arguments if argument != "--trust"]
        own = dict(a.split("=", 1) for a in given if a.split("=", 1)[0] in OWN and "=" in a)
        if not own.keys() & {"run", "pretrained"} or not all("=" in argument for argument in given):
            message = f"{usage}; received: {' '.join(arguments) or 'nothing'}"
            raise UserError(message)
        name = own.get("pretrained")
        folder = Path(own.get("run", f"runs/pretrained_{name}"))
        if name is not None and (folder / "config.yaml").exists():
            message = (
                f"run {folder}: expected a folder for pretrained={name}; received another run. Name a new one"
            )
            raise UserError(message)
        overrides = [a for a in given if a.split("=", 1)[0] not in OWN]
        source = folder if name is None else shipped(name)
        return cls(
            source, folder, own.get("ckpt", "best"), own.get("name"), overrides, len(given) < len(arguments)
        )


def run_config(folder: Path, request: Request) -> DictConfig:
    """Return the configuration of a run with what is chosen again.

    Raises:
        UserError: it is missing or damaged, names what is not trusted, or an override has no effect.
    """
    path = folder / "config.yaml"
    content = read_plain(path)
    missing = [key for key in (*NODES, *KEYS) if key not in content]
    if missing:
        message = f"{path}: expected the configuration of a run; received one without {', '.join(missing)}"
        raise UserError(message)
    content["data"] = {key: content["data"].get(key) for key in DATA}
    if not request.trust:
        require_trusted(path, content, (*NODES, *KEYS))
    cfg = OmegaConf.create({key: content[key] for key in (*NODES, *KEYS)})
    pairs = [parsed(text) for text in request.overrides]
    groups = [f"{key}={chosen(key, value)}" for key, value in pairs if key in GROUPS]
    if groups:
        anew = composed(groups)
        for key in {group.partition("=")[0] for group in groups}:
            cfg[key] = anew[key]
    for key, value in pairs:
        if key not in GROUPS:
            change(cfg, content, key, value)
    return cfg


def change(cfg: DictConfig, content: dict[str, Any], key: str, value: Any) -> None:
    """Set a key of a run's configuration.

    Raises:
        UserError: it is unknown, a whole node, or belongs to the training.
    """
    top, _, rest = key.partition(".")
    made = top == "data" and rest and rest.split(".")[0] not in DATA
    known = [name for name in dotted(OmegaConf.to_container(cfg)) if not name.startswith("data.")]
    known += [f"data.{name}" for name in DATA]
    if key in known:
        OmegaConf.update(cfg, key, value)
        return
    if (top in content and top not in (*NODES, *KEYS)) or made:
        message = (
            f"{key}: expected a key that acts on a finished run; received one that belongs to its training"
        )
    elif top in NODES and not rest:
        message = (
            f"{top}: expected a single key, {top}.KEY=VALUE; received {value!r}. "
            f"Train again for another {top}"
        )
    else:
        message = f"configuration: unknown key {key!r}{nearest(key, known)}"
    raise UserError(message)


def dotted(values: Any, prefix: str = "") -> list[str]:
    """Return the dotted names of all leaves of nested values."""
    if not isinstance(values, dict):
        return [prefix[:-1]]
    return [name for key, value in values.items() for name in dotted(value, f"{prefix}{key}.")]


def parsed(text: str) -> tuple[str, Any]:
    """Return key and value of an override, written as for a training; raises UserError for anything else."""
    from hydra.core.override_parser.types import OverrideType

    from ahnn.cli.commandline import parse

    override = parse(text)
    if override.type is not OverrideType.CHANGE or override.is_sweep_override():
        message = f"override {text!r}: expected key=value with one value; a finished run takes no other"
        raise UserError(message)
    return override.key_or_group, override.value()


def chosen(group: str, value: Any) -> str:
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


def composed(groups: list[str]) -> DictConfig:
    """Return the configuration that Hydra composes of some groups."""
    from hydra import compose, initialize_config_dir

    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        return compose("train", [*groups, "folder=."])


def provenance_note(run: Run, splits: SplitData) -> str:
    """Return how the test trajectories relate to those of the training.

    Raises:
        UserError: some of them are the same.
    """
    known, recipe = run.about.get("data"), splits.source.recipe()
    if known is None:
        return "unknown training data"
    if known["recipe"] != recipe:
        return "other trajectories than those of the training"
    if known["split"] == list(splits.fractions):
        return "the test split of the training's data"
    count = len(splits.source.read().states)
    then, now = (split_sizes(count, fractions) for fractions in (known["split"], list(splits.fractions)))
    if now[0] + now[1] < then[0] + then[1]:
        seen = then[0] + then[1] - now[0] - now[1]
        message = (
            f"data.split: expected test trajectories that the training has not seen; received "
            f"{splits.fractions}: {seen} of {now[2]} are part of it. Keep the training's "
            f"{known['split']}, or draw others with data.seed"
        )
        raise UserError(message)
    return "a part of the test split of the training's data"
