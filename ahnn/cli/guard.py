"""Errors as one message and an exit code.

Exit codes: 0 done, 2 a mistake in what was asked for, 3 training could not go on, 128 + n stopped by signal
n, which is 130 for Ctrl-C, 143 for SIGTERM and 129 for SIGHUP.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable
from typing import Any

from ahnn.cli.stops import listen
from ahnn.errors import Stopped, TrainingError, UserError


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
    except Exception as error:
        if type(error).__module__.partition(".")[0] in ("hydra", "omegaconf"):  # some of them are OSErrors
            cause = error.__cause__
            return report(
                str(cause) if isinstance(cause, UserError | TrainingError) else configured(error), 2
            )
        if not isinstance(error, OSError):
            raise
        place = f"file {error.filename}" if error.filename else "files"
        return report(f"{place}: {error.strerror or error}", 2)
    return 0


def configured(error: Exception) -> str:
    """Return what Hydra or OmegaConf says of a configuration, on one line with the key."""
    from ahnn.cli.commandline import first_line

    key = getattr(error, "full_key", None)
    return f"configuration: {first_line(error)}{f' ({key})' if key else ''}"


def report(message: str, code: int) -> int:
    """Write a message to standard error and return the code."""
    sys.stderr.write(f"ahnn: {message}\n")
    return code
