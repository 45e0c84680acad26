"""Signals that the server of `_forked` ignores after this import; its jobs restore the handlers."""

import signal

from ahnn.errors import TERMINATIONS

HANDLERS = {number: signal.signal(number, signal.SIG_IGN) for number in TERMINATIONS}
