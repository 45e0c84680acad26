"""Signals that the server of `_forked` holds back from its import on; its jobs take the handlers back."""

import signal

HANDLERS = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGTERM, signal.SIGHUP)}
