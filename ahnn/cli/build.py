"""Objects from nodes of a configuration, their arguments checked against what they are for."""

from __future__ import annotations

import contextlib
import functools
import inspect
import itertools
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.errors import InstantiationException
from hydra.utils import get_object, instantiate
from omegaconf import DictConfig, OmegaConf

from ahnn.arguments import check_arguments
from ahnn.errors import TrainingError, UserError


def build(node: Any, who: str, kind: type = object, **offered: Any) -> Any:
    """Instantiate the `_target_` of a node after checking its arguments.

    Args:
        node: a configuration node with `_target_`.
        who: its name, for messages; a nested node with a `_target_` is built unchecked.
        kind: what it has to be.
        offered: further arguments, objects allowed; a target gets those that it has parameters for.

    Raises:
        UserError: no such target, an unknown or missing argument, one that it refuses, or another kind.
    """
    arguments = plain_config(node) if isinstance(node, DictConfig) else {}
    target = arguments.pop("_target_", None)
    partial = arguments.pop("_partial_", False)
    if target is None:
        received = f"keys {', '.join(arguments)}" if arguments else repr(node)
        message = f"{who}: expected a node with _target_; received {received}"
        raise UserError(message)
    try:
        function = get_object(target)
        inspect.signature(function)
    except Exception as error:
        reason = " ".join(str(error).split())
        message = f"{who}: expected _target_ to name a class or function; received {target!r} ({reason})"
        raise UserError(message) from error
    check_arguments(who, function, arguments, offered, partial=partial)
    with blaming(who):
        made = instantiate(node, _convert_="all", _partial_=True)
    taken = inspect.signature(function).parameters
    passed = {name: value for name, value in offered.items() if name in taken}
    call = blaming(who)(functools.partial(made, **passed))
    if partial:
        return call
    thing = call()
    if not isinstance(thing, kind):
        message = f"{who}: expected {kind.__name__}; received {type(thing).__name__}"
        raise UserError(message)
    return thing


@contextlib.contextmanager
def blaming(who: str) -> Iterator[None]:
    """Turn what a constructor says of its arguments into a message that names the configuration node."""
    try:
        yield
    except (UserError, TrainingError, OSError, AssertionError):  # they speak for themselves
        raise
    except Exception as error:
        cause = error.__cause__ if isinstance(error, InstantiationException) and error.__cause__ else error
        if isinstance(cause, UserError | TrainingError):
            raise cause from None
        said = " ".join(str(cause).split()) or type(cause).__name__
        message = f"{who}: {said}"
        raise UserError(message) from error


def build_all(nodes: DictConfig, who: str, kind: type = object) -> dict[str, Any]:
    """Instantiate every named entry of a group; an entry set to null is left out."""
    given = {str(name): node for name, node in nodes.items() if node is not None}
    return {name: build(node, f"{who}.{name}", kind) for name, node in given.items()}


def plain_config(cfg: Any, who: str = "configuration") -> dict[str, Any]:
    """Return a configuration as plain, resolved values.

    Raises:
        UserError: a value in place of keys.
    """
    if not isinstance(cfg, DictConfig):
        message = f"{who}: expected keys with values; received {cfg!r}"
        raise UserError(message)
    return OmegaConf.to_container(cfg, resolve=True)  # pyright: ignore[reportReturnType]


def stored(cfg: DictConfig) -> bytes:
    """Return the configuration as plain YAML; what plugins take from `measurement` stays linked to it."""
    plugins = OmegaConf.to_container(cfg.plugins, resolve=False)
    return OmegaConf.to_yaml(OmegaConf.create({**plain_config(cfg), "plugins": plugins})).encode()


def new_folder(path: str) -> str:
    """Make a folder of this name, or with a number behind it, that no other process has; resolver of YAML.

    None is made for a job that Hydra has given a folder already, nor for a command that only looks.
    """
    placed = HydraConfig.initialized() and not OmegaConf.is_missing(HydraConfig.get().runtime, "output_dir")
    if placed or {"--cfg", "-c"} & {*sys.argv}:
        return path
    for number in itertools.count(1):
        folder = Path(path if number == 1 else f"{path}_{number}")
        with contextlib.suppress(FileExistsError):
            folder.mkdir(parents=True)
            return str(folder)
    raise AssertionError


OmegaConf.register_new_resolver("new_folder", new_folder, replace=True, use_cache=True)
