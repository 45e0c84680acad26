"""Signals ignored by the server of `_forked` from its import on; its jobs restore the handlers."""

import signal

HANDLERS = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGTERM, signal.SIGHUP)}
