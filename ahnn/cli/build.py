"""Between Hydra and the library: objects from YAML with checked arguments, and errors as one message.

Exit codes: 0 done, 2 a mistake in what was asked for, 3 training could not go on, 130 stopped by Ctrl-C.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import logging
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException, InstantiationException
from hydra.types import RunMode
from hydra.utils import get_object, instantiate
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from ahnn.arguments import check_arguments, check_names, nearest
from ahnn.cli.explain import NO_OPTION, dotted_keys, explain
from ahnn.cli.stops import listen
from ahnn.errors import Stopped, TrainingError, UserError
from ahnn.paths import conf_dir

log = logging.getLogger("ahnn")

__all__ = ["build", "build_all", "dotted_keys", "guard", "plain_config", "run_hydra"]


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
    except Exception as error:
        message = f"{who}: expected _target_ to name a class or function; received {target!r} ({error})"
        raise UserError(message) from error
    check_names(who, function, arguments, offered, partial=partial)
    built = {name for name, value in arguments.items() if isinstance(value, dict) and "_target_" in value}
    check_arguments(who, function, {k: v for k, v in arguments.items() if k not in built})
    with blaming(who):
        made = instantiate(node, _convert_="all", _partial_=True)
    taken = inspect.signature(function).parameters
    passed = {name: value for name, value in offered.items() if name in taken}
    call = functools.partial(_call, who, made, **passed)
    if partial:
        return call
    thing = call()
    if not isinstance(thing, kind):
        message = f"{who}: expected {kind.__name__}; received {type(thing).__name__}"
        raise UserError(message)
    return thing


def _call(who: str, made: Callable[..., Any], /, *arguments: Any, **named: Any) -> Any:
    with blaming(who):
        return made(*arguments, **named)


@contextlib.contextmanager
def blaming(who: str) -> Iterator[None]:
    """Turn what a constructor says of its arguments into a message that names the configuration node."""
    try:
        yield
    except (UserError, TrainingError):
        raise
    except Exception as error:
        from lightning.fabric.utilities.exceptions import MisconfigurationException

        cause = error.__cause__ if isinstance(error, InstantiationException) and error.__cause__ else error
        if isinstance(cause, UserError | TrainingError):
            raise cause from None
        refusals = (TypeError, ValueError, LookupError, AttributeError, ArithmeticError, ImportError)
        if not isinstance(cause, (*refusals, HydraException, MisconfigurationException)):
            raise
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


def stencil(loss: DictConfig) -> int:
    """Return the steps that a training window must span for the derivatives of a loss; resolver of YAML."""
    return int(loss.order) if loss.derivative else 1


OmegaConf.register_new_resolver("stencil", stencil, replace=True)


def run_hydra(task: Callable[[DictConfig], Any], config_name: str = "train") -> None:
    """Run a task under Hydra; a user's mistake ends in one message and an exit code, not a traceback."""
    os.environ["HYDRA_FULL_ERROR"] = "1"  # makes Hydra raise, so that the messages are ours
    # Hydra takes no null for a group. For one that is empty anyway it means what leaving it away does.
    sys.argv = [argument for argument in sys.argv if argument not in ("experiment=null", "sweep=null")]

    @functools.wraps(task)
    def tidy(cfg: DictConfig) -> Any:
        if HydraConfig.get().mode is RunMode.MULTIRUN or cfg.get("trial") is not None:
            return checked(cfg)  # who runs several jobs has to see how each of them ended
        if code := guard(lambda: checked(cfg)):
            forget(Path(cfg.folder))
            sys.exit(code)  # past Hydra, which would say that there was an error
        return None

    def checked(cfg: DictConfig) -> Any:
        check_preset()
        return task(cfg)

    entry = hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name=config_name)(tidy)
    sys.exit(guard(entry))


def check_preset() -> None:
    """Check the one group that may be without its file: not every budget has a preset of every system.

    Raises:
        UserError: an option that was asked for by name and does not exist.
    """
    choices = HydraConfig.get().runtime.choices
    name = choices.get("preset")
    if name in (None, f"{choices.get('budget')}_{choices.get('system')}"):
        return
    options = GlobalHydra.instance().config_loader().get_group_options("preset")
    if name not in options:
        message = f"configuration: preset: unknown option {name!r}{nearest(name, options)}"
        raise UserError(message)


def forget(folder: Path) -> None:
    """Remove what Hydra wrote for a run that never began, with none of its seeds."""
    if not any((f / "config.yaml").exists() for f in (folder, *folder.glob("seed_*"))):
        shutil.rmtree(folder / ".hydra", ignore_errors=True)
        with contextlib.suppress(OSError):
            folder.rmdir()


def guard(entry: Callable[[], Any]) -> int:
    """Call an entry point and return its exit code."""
    listen()
    try:
        entry()
    except Stopped as stop:
        return report(str(stop) or f"stopped by {stop.signal.name}; the same command begins anew", stop.code)
    except KeyboardInterrupt:
        return report("stopped by Ctrl-C; the same command begins anew", 130)
    except TrainingError as error:
        return report(str(error), 3)
    except UserError as error:
        return report(str(error), 2)
    except (HydraException, OmegaConfBaseException) as error:  # before OSError, which some of them are
        if isinstance(error.__cause__, UserError | TrainingError):
            return report(str(error.__cause__), 2)
        return report(explain(error), 2)
    except OSError as error:
        return report(f"file {error.filename}: {error.strerror or error}", 2)
    except ValueError as error:
        if not str(error).startswith(NO_OPTION):
            raise
        return report(explain(error), 2)
    return 0


def report(message: str, code: int) -> int:
    """Write a message to standard error and return the code."""
    sys.stderr.write(f"ahnn: {message}\n")
    return code
