"""Conversion of errors into one message and an exit code.

Exit codes: 0 done, 2 user error, 3 training, a prediction or a fit failed, 128 + n stopped by signal n: 130
for Ctrl-C, 143 for SIGTERM and 129 for SIGHUP. A closed pipe, as with `| head`, gives the code of SIGPIPE,
141, without a message.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import logging
import os
import re
import signal
import sys
import traceback
from collections.abc import Callable, Iterator
from typing import Any, NoReturn

from ahnn.cli.early_stops import arrived, code_of, listen
from ahnn.errors import Stopped, TrainingError, UserError, WrongUsage
from ahnn.memory import keep_freed

OURS = (UserError, TrainingError)
NO_MEMORY = re.compile(r"can't allocate memory|out of memory", re.IGNORECASE)
"""Pattern of torch's out-of-memory messages, which occur in errors of any type."""


def run_command(
    task: Callable[[list[str]], Any], about: str | None, level: int = logging.WARNING
) -> NoReturn:
    """Run a task on the command line arguments, or show its help, and exit with its code.

    Args:
        task: function of the command line arguments.
        about: text of `--help`, with the command in backquotes in its first line.
        level: level of the messages shown.
    """
    arguments = sys.argv[1:]
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    if level != logging.WARNING:
        logging.getLogger("ahnn").setLevel(level)

    def entry() -> None:
        if {"-h", "--help"} & {*arguments}:
            sys.stdout.write(f"{about}\n")
            return
        try:
            task(arguments)
        except WrongUsage as error:
            usage = (about or "``").split("`")[1]
            message = f"usage: {usage}; {error}; --help lists the keys"
            raise UserError(message) from error

    leave(guard(entry))


def guard(entry: Callable[[], Any]) -> int:
    """Call an entry point and return its exit code."""
    for name in ("stdout", "stderr"):  # a service may have closed the standard streams
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 - open for the lifetime of the process
    for stream in (sys.stdout, sys.stderr):  # ASCII terminals show ? for ²
        with contextlib.suppress(AttributeError, OSError, ValueError):
            stream.reconfigure(errors="replace")  # pyright: ignore[reportAttributeAccessIssue]
    keep_freed()
    _end_quietly()
    listen()
    try:
        entry()
        sys.stdout.flush()  # a full disk or a closed pipe is detected here instead of at exit
    except (Stopped, KeyboardInterrupt) as stop:
        return end(stop)
    except Exception as error:
        if stop := stop_behind(error) or arrived():
            return end(stop)
        if isinstance(error, OURS):
            return report(error)
        if of_configuration(error):  # some are OSErrors
            return report(configured(error))
        if isinstance(error, MemoryError) or NO_MEMORY.search(str(error)):
            said = " ".join(str(error).split()) or "the system denied a request"
            return report(f"memory: expected a job that fits; received: {said}. Reduce the job")
        if in_library(error):
            said = " ".join(f"{type(error).__name__}: {error}".split())
            return report(f"environment: cannot import a library ({said}). Check the environment variables")
        if not isinstance(error, OSError):
            raise
        if isinstance(error, BrokenPipeError):
            return 141  # 128 + SIGPIPE, a signal that Windows lacks
        place = f"file {error.filename}" if error.filename else "standard output or a file"
        return report(f"{place}: {error.strerror or error}")
    return 0


@functools.cache
def _end_quietly() -> None:
    """Discard output of libraries after the exit handlers, if Triton is imported.

    Lightning imports it; Triton 3.9 then prints thirty lines about leaks whenever a process ends.
    """

    def discard() -> None:
        if "triton" in sys.modules:
            sys.stderr.flush()
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)

    atexit.register(discard)  # registered before the handlers of libraries, and therefore called after them


def leave(code: int) -> NoReturn:
    """Exit with a code, discarding unwritten standard output."""
    try:
        sys.stdout.flush()
    except OSError:
        with contextlib.suppress(OSError, ValueError):  # Python tries again at exit
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(code)


def end(stop: BaseException) -> int:
    """Report what stopped the command and return the exit code."""
    known = stop if isinstance(stop, Stopped) else Stopped(signal.SIGINT)
    return report(known if str(known) else known.saying("repeating the command starts from the beginning"))


def stop_behind(error: BaseException) -> BaseException | None:
    """Return the stop exception hidden by an error during its clean-up."""
    while error.__context__ is not None:
        error = error.__context__
        if isinstance(error, Stopped | KeyboardInterrupt):
            return error
    return None


def in_library(error: Exception) -> bool:
    """Return whether an exception comes from the body of a foreign module, i.e. a failed import."""
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    bodies = any(frame.f_code.co_name == "<module>" for frame in frames)
    return bodies and not frames[-1].f_globals.get("__name__", "").startswith("ahnn")


@contextlib.contextmanager
def in_words() -> Iterator[None]:
    """Convert configuration errors of Hydra and OmegaConf into UserError, for use from Python."""
    try:
        yield
    except Exception as error:
        if not of_configuration(error):
            raise
        raise UserError(str(configured(error))) from error


def of_configuration(error: Exception) -> bool:
    """Return whether an exception comes from Hydra or OmegaConf."""
    return type(error).__module__.partition(".")[0] in ("hydra", "omegaconf")


def configured(error: Exception) -> Exception | str:
    """Return a Hydra or OmegaConf message on one line with the key, or the `ahnn` error that caused it."""
    from ahnn.cli.commandline import first_line

    if isinstance(error.__cause__, OURS):
        return error.__cause__
    key = getattr(error, "full_key", None)
    return f"configuration: {first_line(error)}{f' ({key})' if key else ''}"


def report(said: BaseException | str) -> int:
    """Write a message to standard error and return its exit code."""
    with contextlib.suppress(OSError):  # without a stream only the exit code remains
        sys.stderr.write(f"ahnn: {said}\n")
    return code_of(said) if isinstance(said, Stopped) else 3 if isinstance(said, TrainingError) else 2
