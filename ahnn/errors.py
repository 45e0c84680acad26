"""The two kinds of stop that a user sees as one message instead of a traceback."""

from __future__ import annotations


class UserError(ValueError):
    """A mistake in what the user asked for; the message says who, expected, received and the remedy."""


class TrainingError(RuntimeError):
    """Training cannot go on (for example a non-finite loss); the message says where it stopped."""
