"""Signals ignored by the server of `_forked` from its import on; its jobs restore the handlers."""

import signal

from ahnn.errors import TERMINATIONS

HANDLERS = {number: signal.signal(number, signal.SIG_IGN) for number in TERMINATIONS}
