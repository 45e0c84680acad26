"""From the command line to a task under Hydra, and from its errors to one message and an exit code.

Exit codes: 0 done, 2 a mistake in what was asked for, 3 training could not go on, 128 + n stopped by signal
n, which is 130 for Ctrl-C, 143 for SIGTERM and 129 for SIGHUP.
"""

from __future__ import annotations

import contextlib
import functools
import os
import shutil
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from ahnn.cli import commandline
from ahnn.cli.help import show_completion, show_help
from ahnn.cli.stops import listen
from ahnn.errors import Stopped, TrainingError, UserError
from ahnn.paths import conf_dir


def run_hydra(task: Callable[[DictConfig], Any], config_name: str = "train") -> None:
    """Run a task under Hydra; a user's mistake ends in one message and an exit code, not a traceback."""
    os.environ["HYDRA_FULL_ERROR"] = "1"  # makes Hydra raise, so that the messages are ours
    # Hydra takes no null for a group. For a group that is empty by default it is as good as no word.
    sys.argv = [argument for argument in sys.argv if argument not in ("experiment=null", "sweep=null")]
    sys.exit(guard(lambda: start(task, config_name)))


def start(task: Callable[[DictConfig], Any], config_name: str) -> None:
    """Answer a request for help or completion, or check the command line and hand it to Hydra."""
    args = commandline.read(sys.argv[1:])
    if args.help:
        return show_help(args)
    if args.shell_completion and show_completion(args):
        return None
    commandline.check(args, config_name)
    own = named_folder(args.overrides)
    is_new = own is None or not own.exists()
    if not is_new:  # what lies in it is somebody's property: Hydra must not write there before we have looked
        sys.argv.append("hydra.output_subdir=null")

    @functools.wraps(task)
    def tidy(cfg: DictConfig) -> Any:
        if HydraConfig.get().mode is RunMode.MULTIRUN or cfg.get("trial") is not None:
            return task(cfg)  # who runs several jobs has to see how each of them ended
        if code := guard(lambda: task(cfg)):
            if is_new:
                forget(Path(HydraConfig.get().runtime.output_dir))
            sys.exit(code)  # past Hydra, which would say that there was an error
        return None

    return hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name=config_name)(tidy)()


def named_folder(overrides: Sequence[str]) -> Path | None:
    """Return the run folder that a command line names; None takes a new one."""
    named = [text.partition("=")[2] for text in overrides if text.startswith(("run=", "hydra.run.dir="))]
    return Path(named[-1].strip("'\"")) if named else None


def forget(folder: Path) -> None:
    """Remove the folder that this process made for a run that never began, with none of its seeds."""
    if not any((f / "config.yaml").exists() for f in (folder, *folder.glob("seed_*"))):
        shutil.rmtree(folder / ".hydra", ignore_errors=True)
        with contextlib.suppress(OSError):
            folder.rmdir()


def guard(entry: Callable[[], Any]) -> int:
    """Call an entry point and return its exit code."""
    for stream in (sys.stdout, sys.stderr):  # a terminal that knows ASCII alone shows ? for ²
        with contextlib.suppress(AttributeError):
            stream.reconfigure(errors="replace")  # pyright: ignore[reportAttributeAccessIssue]
    listen()
    try:
        entry()
    except Stopped as stop:
        again = "the same command starts again from the beginning"
        return report(str(stop) or f"stopped by {stop.signal.name}; {again}", stop.code)
    except KeyboardInterrupt:
        return report("stopped by Ctrl-C; the same command starts again from the beginning", 130)
    except TrainingError as error:
        return report(str(error), 3)
    except UserError as error:
        return report(str(error), 2)
    except (HydraException, OmegaConfBaseException) as error:  # before OSError, which some of them are
        if isinstance(error.__cause__, UserError | TrainingError):
            return report(str(error.__cause__), 2)
        key = error.full_key if isinstance(error, OmegaConfBaseException) else None
        return report(f"configuration: {commandline.first_line(error)}{f' ({key})' if key else ''}", 2)
    except OSError as error:
        place = f"file {error.filename}" if error.filename else "files"
        return report(f"{place}: {error.strerror or error}", 2)
    return 0


def report(message: str, code: int) -> int:
    """Write a message to standard error and return the code."""
    sys.stderr.write(f"ahnn: {message}\n")
    return code
