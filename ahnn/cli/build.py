"""Objects from nodes of a configuration, their arguments checked against what they are for."""

from __future__ import annotations

import contextlib
import functools
import inspect
import itertools
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from hydra.core.hydra_config import HydraConfig
from hydra.errors import InstantiationException
from hydra.utils import get_object, instantiate
from omegaconf import DictConfig, OmegaConf

from ahnn.arguments import check_arguments
from ahnn.errors import TrainingError, UserError


class Part(NamedTuple):
    """A node with `_target_`.

    Attributes:
        node: of the configuration; a nested node with a `_target_` is built unchecked.
        kind: what it has to be.
        given: names of further arguments, objects allowed; a target gets those that it has parameters for.
    """

    node: Any
    kind: type = object
    given: Collection[str] = ()


def factories(parts: Mapping[str, Part]) -> dict[str, Callable[..., Any]]:
    """Return what builds each of several nodes, called with the arguments that are given to it.

    Raises:
        UserError: begins with the name of a node: no such target, an unknown or missing argument, or one of
            another type. What a target refuses itself, and another kind, is said when it is built.
    """
    return {who: factory(who, part) for who, part in parts.items()}


def factory(who: str, part: Part) -> Callable[..., Any]:
    """Return what builds a node; raises as `factories`."""
    arguments = plain_config(part.node) if isinstance(part.node, DictConfig) else {}
    target = arguments.pop("_target_", None)
    partial = arguments.pop("_partial_", False)
    if target is None:
        received = f"keys {', '.join(arguments)}" if arguments else repr(part.node)
        message = f"{who}: expected a node with _target_; received {received}"
        raise UserError(message)
    try:
        function = get_object(target)
        taken = inspect.signature(function).parameters
    except Exception as error:
        reason = " ".join(str(error).split())
        message = f"{who}: expected _target_ to name a class or function; received {target!r} ({reason})"
        raise UserError(message) from error
    check_arguments(who, function, arguments, part.given, partial=partial)

    def build_it(**offered: Any) -> Any:
        with blaming(who):
            made = instantiate(part.node, _convert_="all", _partial_=True)
        passed = {name: value for name, value in offered.items() if name in taken}
        call = blaming(who)(functools.partial(made, **passed))
        if partial:
            return call
        thing = call()
        if not isinstance(thing, part.kind):
            message = f"{who}: expected {part.kind.__name__}; received {type(thing).__name__}"
            raise UserError(message)
        return thing

    return build_it


def build(node: Any, who: str, kind: type = object, **offered: Any) -> Any:
    """Instantiate the `_target_` of a node after checking its arguments; raises as `factories`."""
    return factory(who, Part(node, kind, offered))(**offered)


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


def each(nodes: DictConfig, who: str, kind: type = object) -> dict[str, Part]:
    """Return the named entries of a group under dotted names; an entry set to null is left out."""
    return {f"{who}.{name}": Part(node, kind) for name, node in nodes.items() if node is not None}


def build_all(nodes: DictConfig, who: str, kind: type = object) -> dict[str, Any]:
    """Instantiate every named entry of a group."""
    made = factories(each(nodes, who, kind))
    return {name.removeprefix(f"{who}."): build_it() for name, build_it in made.items()}


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
