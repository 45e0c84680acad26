"""Between Hydra and the library: objects from YAML with checked arguments, and errors as one message.

Exit codes: 0 done, 2 a mistake in what was asked for, 3 training could not go on.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import logging
import os
import re
import shutil
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from hydra.utils import get_object, instantiate
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from ahnn.arguments import check_arguments, nearest
from ahnn.errors import TrainingError, UserError
from ahnn.paths import conf_dir

log = logging.getLogger("ahnn")


def build(node: DictConfig, who: str, **offered: Any) -> Any:
    """Instantiate the `_target_` of a node after checking its arguments.

    Args:
        node: a configuration node with `_target_`.
        who: its name, for messages; a nested node with a `_target_` is built unchecked.
        offered: further arguments, objects allowed; a target gets those that it has parameters for.

    Raises:
        UserError: no such target, an unknown or missing argument, or one of a wrong type.
    """
    arguments = plain_config(node)
    target = arguments.pop("_target_", None)
    partial = arguments.pop("_partial_", False)
    if target is None:
        message = f"{who}: expected a node with _target_; received keys {', '.join(arguments) or 'none'}"
        raise UserError(message)
    try:
        function = get_object(target)
    except Exception as error:
        message = f"{who}: expected _target_ to name a class or function; received {target!r} ({error})"
        raise UserError(message) from error
    if target.split(".")[0] not in ("lightning", "torch"):
        built = {name for name, value in arguments.items() if isinstance(value, dict) and "_target_" in value}
        check_arguments(who, function, {k: v for k, v in arguments.items() if k not in built})
    taken = inspect.signature(function).parameters
    passed = {name: value for name, value in offered.items() if name in taken}
    made = functools.partial(instantiate(node, _convert_="all", _partial_=True), **passed)
    return made if partial else made()


def build_all(nodes: DictConfig, who: str) -> dict[str, Any]:
    """Instantiate every named entry of a group; an entry set to null is left out."""
    return {str(name): build(node, f"{who}.{name}") for name, node in nodes.items() if node is not None}


def plain_config(cfg: Any) -> dict[str, Any]:
    """Return a configuration as plain, resolved values."""
    return OmegaConf.to_container(cfg, resolve=True)  # pyright: ignore[reportReturnType]


def stencil(loss: DictConfig) -> int:
    """Return the steps that a training window must span for the derivatives of a loss; resolver of YAML."""
    return int(loss.order) if loss.derivative else 1


OmegaConf.register_new_resolver("stencil", stencil, replace=True)


def run_hydra(task: Callable[[DictConfig], Any], config_name: str = "train") -> None:
    """Run a task under Hydra; a user's mistake ends in one message and an exit code, not a traceback."""
    os.environ["HYDRA_FULL_ERROR"] = "1"  # makes Hydra raise, so that the messages are ours

    @functools.wraps(task)
    def tidy(cfg: DictConfig) -> Any:
        try:
            return task(cfg)
        except UserError:
            forget(Path(cfg.folder))
            raise

    entry = hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name=config_name)(tidy)
    sys.exit(guard(entry))


def forget(folder: Path) -> None:
    """Remove what Hydra wrote for a run that never began; a sweep keeps it, to list the failure."""
    if HydraConfig.get().mode is RunMode.RUN and not (folder / "config.yaml").exists():
        shutil.rmtree(folder / ".hydra", ignore_errors=True)
        with contextlib.suppress(OSError):
            folder.rmdir()


def guard(entry: Callable[[], Any]) -> int:
    """Call an entry point and return its exit code."""
    try:
        entry()
    except TrainingError as error:
        return report(str(error), 3)
    except UserError as error:
        return report(str(error), 2)
    except OSError as error:
        return report(f"file {error.filename}: {error.strerror or error}", 2)
    except (HydraException, OmegaConfBaseException) as error:
        if isinstance(error.__cause__, UserError | TrainingError):
            return report(str(error.__cause__), 2)
        return report(explain(error), 2)
    return 0


def report(message: str, code: int) -> int:
    """Write a message to standard error and return the code."""
    sys.stderr.write(f"ahnn: {message}\n")
    return code


def explain(error: Exception) -> str:
    """Return a configuration error of Hydra or OmegaConf as one message with the nearest valid key."""
    source = error if str(error).strip() else (error.__cause__ or error.__context__ or error)
    lines = [line for line in str(source).splitlines() if line.strip()]
    text = lines[0] if lines else type(source).__name__
    if text.endswith(":") and len(lines) > 1:  # Hydra names the target first, and what it said below
        text = f"{text} {lines[1]}"
    wrong = re.search(r"Could not override '([\w.@]+)'", text) or re.search(r"Key '([\w.]+)'", text)
    if wrong:
        return f"configuration: unknown key {wrong[1]!r}{nearest_key(wrong[1])}"
    missing = re.search(r"Could not find '([\w/]+)/([\w.]+)'", text)
    if missing:
        options = [line.strip() for line in lines[2:] if line.startswith("\t")]
        return f"configuration: {missing[1]}: unknown option {missing[2]!r}{nearest(missing[2], options)}"
    detail = f" ({error.full_key})" if isinstance(error, OmegaConfBaseException) and error.full_key else ""
    return f"configuration: {text}{detail}"


def nearest_key(wrong: str) -> str:
    """Return a hint with the valid dotted key that is closest to a wrong one, groups included."""
    from hydra import compose, initialize_config_dir
    from hydra.core.global_hydra import GlobalHydra

    GlobalHydra.instance().clear()
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        cfg = compose("train", return_hydra_config=False)
    groups = [folder.name for folder in conf_dir().iterdir() if folder.is_dir()]
    return nearest(wrong, sorted({*dotted_keys(cfg), *groups})) if wrong else ""


def dotted_keys(cfg: Any, prefix: str = "") -> Iterable[str]:
    """Yield every key of a nested configuration, dotted."""
    for key, value in OmegaConf.to_container(cfg, resolve=False).items():  # pyright: ignore
        yield f"{prefix}{key}"
        if isinstance(value, dict):
            yield from dotted_keys(OmegaConf.create(value), f"{prefix}{key}.")
