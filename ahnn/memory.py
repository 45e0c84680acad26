"""Whether a request fits into memory, checked before anything is allocated."""

from __future__ import annotations

import os

from ahnn.errors import UserError


def available() -> int:
    """Return the bytes of memory of this machine."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def require_memory(who: str, what: str, size: float) -> None:
    """Check an estimate of bytes against the memory of the machine.

    Args:
        who: the parameters that determine the size, for the message.
        what: of what size, for the message.
        size: bytes.

    Raises:
        UserError: it does not fit.
    """
    if size > available():
        message = (
            f"{who}: expected {what} that fit into {available() / 1e9:.0f} GB; received {size / 1e9:.3g} GB. "
            "Ask for less"
        )
        raise UserError(message)
