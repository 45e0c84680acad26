"""Exceptions that a user sees as one message instead of a traceback."""

from __future__ import annotations

import signal


class UserError(ValueError):
    """Invalid user input; the message names the source, the expected and received values, and the remedy."""


class WrongUsage(UserError):
    """A command line without what the command needs; the message states what was received."""


class Occupied(UserError):
    """Another process uses the folder."""


class TrainingError(RuntimeError):
    """Training (for example a non-finite loss), a prediction or a fit fails; the message states where."""


TERMINATIONS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals by which a scheduler or a closed terminal ends a process; Windows has no SIGHUP."""


class Stopped(BaseException):
    """Termination by a signal; not an `Exception`, so that no handler mistakes it for a failure.

    Attributes:
        signal: SIGINT, SIGTERM or SIGHUP.
    """

    def __init__(self, number: int, message: str = "") -> None:
        super().__init__(message)
        self.signal = signal.Signals(number)

    def saying(self, how_to_go_on: str) -> Stopped:
        """Return the exception with a message for the user."""
        cause = "Ctrl-C" if self.signal == signal.SIGINT else self.signal.name
        return Stopped(self.signal, f"stopped by {cause}; {how_to_go_on}")
