"""Entry point of tasks under Hydra."""

from __future__ import annotations

import contextlib
import functools
import os
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import hydra
from hydra._internal.hydra import Hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig

from ahnn.cli import commandline
from ahnn.cli.compose import with_recorded
from ahnn.cli.early_stops import arrived
from ahnn.cli.guard import guard, leave
from ahnn.cli.help import show_completion, show_help
from ahnn.errors import UserError
from ahnn.paths import conf_dir


def run_hydra(task: Callable[[DictConfig], Any]) -> None:
    """Run a task under Hydra; user errors give one message and an exit code, not a traceback."""
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then raises, so that we show the message
    # Hydra does not accept null for a group. For a group that is empty by default it is equivalent to no
    # override.
    given = [argument for argument in sys.argv if argument not in ("experiment=null", "sweep=null")]
    words = commandline.flags_last(commandline.in_one_folder(given[1:]))
    sys.argv = [given[0], *with_recorded([commandline.worded(word) for word in words])]
    leave(guard(lambda: start(task)))


def start(task: Callable[[DictConfig], Any]) -> None:
    """Answer a request for help or completion, or check the command line and pass it to Hydra."""
    args = commandline.read(sys.argv[1:])
    if args.help:
        return show_help(args)
    if args.shell_completion and show_completion(args):
        return None
    first = commandline.check(args, "train")
    own = named_folder(args.overrides)
    is_new = own is None or not own.exists()
    above = [path for path in (own or Path("runs", "day")).absolute().parents if not path.exists()]
    if not is_new:  # the folder may belong to others: Hydra must not write there before our check
        sys.argv.append("hydra.output_subdir=null")

    @functools.wraps(task)
    def tidy(cfg: DictConfig) -> Any:
        if stop := arrived():  # composition swallowed the exception
            raise stop
        if HydraConfig.get().mode is RunMode.MULTIRUN or cfg.get("trial") is not None:
            return task(cfg)  # the launcher of several jobs must see how each job ended
        if code := guard(lambda: task(cfg)):
            if is_new:
                forget(folder := Path(HydraConfig.get().runtime.output_dir))
                for path in above if own is not None else (folder.parent, *above):  # the folder with the date
                    with contextlib.suppress(OSError):
                        path.rmdir()
            leave(code)  # bypasses Hydra, which would report an error
        return None

    with folder_of(own), contextlib.nullcontext() if first is None else known_mode(first.hydra.mode):
        return hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name="train")(tidy)()


@contextlib.contextmanager
def folder_of(run: Path | None) -> Iterator[None]:
    """Convert Hydra's failure to create the run folder into a UserError; other errors are unchanged."""
    try:
        yield
    except OSError as error:
        if run is None or run.is_dir():
            raise
        message = f"run: cannot create the folder {run}: {error.strerror or error}. Choose another"
        raise UserError(message) from error


@contextlib.contextmanager
def known_mode(mode: RunMode | None) -> Iterator[None]:
    """Avoid the extra composition by which Hydra determines its mode, which takes half a second."""
    look_up = Hydra.get_mode
    Hydra.get_mode = lambda *_, **__: mode
    try:
        yield
    finally:
        Hydra.get_mode = look_up


def named_folder(overrides: Sequence[str]) -> Path | None:
    """Return the run folder named on the command line, or None for a new one."""
    named = [text for text in overrides if text.startswith(("run=", "hydra.run.dir="))]
    single = [text for text in named if not commandline.parse(text).is_sweep_override()]
    return Path(str(commandline.pair(single[-1])[1])) if single else None


def forget(folder: Path) -> None:
    """Remove Hydra's files of a run that never began with any seed, and its folder if then empty."""
    if not any((f / "config.yaml").exists() for f in (folder, *folder.glob("seed_*"))):
        shutil.rmtree(folder / ".hydra", ignore_errors=True)
        with contextlib.suppress(OSError):
            folder.rmdir()
