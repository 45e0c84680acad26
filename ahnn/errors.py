"""The kinds of stop that a user sees as one message instead of a traceback."""

from __future__ import annotations

import signal


class UserError(ValueError):
    """A mistake in what the user asked for; the message says who, expected, received and the remedy."""


class Occupied(UserError):
    """Another process works there."""


class TrainingError(RuntimeError):
    """Training cannot go on (for example a non-finite loss); the message says where it stopped."""


class Stopped(BaseException):
    """A signal ended the work; not an `Exception`, so that nothing on the way takes it for a failure.

    Attributes:
        signal: SIGINT, SIGTERM or SIGHUP.
    """

    def __init__(self, number: int, message: str = "") -> None:
        super().__init__(message)
        self.signal = signal.Signals(number)

    def saying(self, how_to_go_on: str) -> Stopped:
        """Return the stop with a message for the user."""
        cause = "Ctrl-C" if self.signal == signal.SIGINT else self.signal.name
        return Stopped(self.signal, f"stopped by {cause}; {how_to_go_on}")
