"""Construction of objects from configuration nodes, with validated arguments."""

from __future__ import annotations

import contextlib
import functools
import inspect
import itertools
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.errors import InstantiationException
from hydra.utils import get_object, instantiate
from omegaconf import DictConfig, OmegaConf, open_dict

from ahnn.arguments import check_arguments
from ahnn.errors import TrainingError, UserError


def factory(node: Any, who: str, kind: type = object, given: Collection[str] = ()) -> Callable[..., Any]:
    """Return the factory of a node with `_target_`, to be called with the given arguments.

    Args:
        node: configuration node; a nested node with a `_target_` is built unchecked.
        who: name of the node.
        kind: required type.
        given: names of further arguments, which may be objects; those that the target accepts are passed.

    Raises:
        UserError: an unknown target, or an argument that is unknown, missing or of the wrong type; the
            message begins with the name of the node. Errors of the target itself, and a wrong kind, are
            raised on construction.
    """
    arguments = plain_config(node) if isinstance(node, DictConfig) else {}
    target = arguments.pop("_target_", None)
    partial = arguments.pop("_partial_", False)
    if target is None:
        received = f"keys {', '.join(arguments)}" if arguments else repr(node)
        message = f"{who}: expected a node with _target_; received {received}"
        raise UserError(message)
    function, taken = named(who, target)
    check_arguments(who, function, arguments, given, partial=partial)

    def build_it(**offered: Any) -> Any:
        with blaming(who):
            made = instantiate(node, _convert_="all", _partial_=True)
        passed = {name: value for name, value in offered.items() if name in taken}
        call = blaming(who, taken.keys() - passed.keys())(functools.partial(made, **passed))
        if partial:
            return call
        thing = call()
        if not isinstance(thing, kind):
            message = f"{who}: expected {kind.__name__}; received {type(thing).__name__}"
            raise UserError(message)
        return thing

    return build_it


def named(who: str, target: Any) -> tuple[Callable[..., Any], Mapping[str, inspect.Parameter]]:
    """Return the class or function that a `_target_` names, and its parameters; raises UserError."""
    try:
        function = get_object(target)
        return function, inspect.signature(function).parameters
    except Exception as error:
        reason = " ".join(str(error).split())
        message = f"{who}: expected _target_ to name a class or function; received {target!r} ({reason})"
        raise UserError(message) from error


def without_network(cfg: DictConfig) -> DictConfig:
    """Return a configuration without the network of the recipe, if the class of its model takes none.

    Raises:
        UserError: the model names no class.
    """
    if not isinstance(cfg.model, DictConfig) or "network" not in cfg.model or "_target_" not in cfg.model:
        return cfg
    taken = named("model", cfg.model._target_)[1]
    if "network" in taken or any(p.kind is p.VAR_KEYWORD for p in taken.values()):
        return cfg
    cfg = cfg.copy()
    with open_dict(cfg):
        del cfg.model["network"]
    return cfg


def build(node: Any, who: str, kind: type = object, **offered: Any) -> Any:
    """Instantiate the `_target_` of a node with checked arguments; raises the same errors as `factory`."""
    return factory(node, who, kind, offered)(**offered)


@contextlib.contextmanager
def blaming(who: str, own: Collection[str] = ()) -> Iterator[None]:
    """Convert constructor errors into messages that name the configuration node.

    Args:
        who: name of the node.
        own: arguments that the user sets; a message that begins with one of them gets its full key.
    """
    try:
        yield
    except UserError as error:
        name, colon, _ = str(error).partition(":")
        if colon and name in own:
            message = f"{who}.{error}"
            raise UserError(message) from error
        raise
    except (TrainingError, OSError, AssertionError):  # these errors are already clear
        raise
    except Exception as error:
        cause = error.__cause__ if isinstance(error, InstantiationException) and error.__cause__ else error
        if isinstance(cause, UserError | TrainingError):
            raise cause from None
        said = " ".join(str(cause).split()) or type(cause).__name__
        message = f"{who}: {said}"
        raise UserError(message) from error


def factories(nodes: DictConfig, who: str, kind: type = object) -> dict[str, Callable[..., Any]]:
    """Return the factories of a group under dotted names; entries set to null are omitted."""
    named_nodes = {f"{who}.{name}": node for name, node in nodes.items() if node is not None}
    return {name: factory(node, name, kind) for name, node in named_nodes.items()}


def build_all(nodes: DictConfig, who: str, kind: type = object) -> dict[str, Any]:
    """Instantiate every named entry of a group."""
    made = factories(nodes, who, kind)
    return {name.removeprefix(f"{who}."): build_it() for name, build_it in made.items()}


def plain_config(cfg: Any) -> dict[str, Any]:
    """Return a configuration as plain, resolved values.

    Raises:
        UserError: the configuration is a value instead of a mapping.
    """
    if not isinstance(cfg, DictConfig):
        message = f"configuration: expected a mapping of keys to values; received {cfg!r}"
        raise UserError(message)
    return OmegaConf.to_container(cfg, resolve=True)  # pyright: ignore[reportReturnType]


def stored(cfg: DictConfig) -> bytes:
    """Return the configuration as plain YAML; references of plugins to `measurement` are kept."""
    plugins = OmegaConf.to_container(cfg.plugins, resolve=False)
    return OmegaConf.to_yaml(OmegaConf.create({**plain_config(cfg), "plugins": plugins})).encode()


def new_folder(path: str) -> str:
    """Create a new folder with a given name, numbered if the name is taken; YAML resolver.

    No folder is created for jobs whose folder Hydra has set, or for read-only commands.
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
