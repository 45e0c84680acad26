"""Early termination by user or scheduler: one message and an exit code."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from ahnn.errors import TERMINATIONS, Stopped, UserError

if TYPE_CHECKING:
    from lightning import Trainer


_arrived: list[int] = []


def _raise(number: int, frame: Any) -> None:
    del frame
    _arrived.append(number)
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise Stopped(number)


def arrived() -> Stopped | None:
    """Return the signal received since `listen`, if any: later failures are attributed to it.

    An interrupted import may swallow the exception and fail differently.
    """
    return Stopped(_arrived[0]) if _arrived else None


def listen() -> None:
    """Let signals raise `KeyboardInterrupt` or `Stopped`, unless they are ignored (nohup)."""
    _arrived.clear()
    _hand_to(_raise)


def _hand_to(handler: Callable[[int, Any], Any]) -> dict[int, Any]:
    """Install a handler for signals that are not ignored; return the former handlers."""
    if threading.current_thread() is not threading.main_thread():
        return {}
    numbers = (signal.SIGINT, *TERMINATIONS)
    return {n: signal.signal(n, handler) for n in numbers if signal.getsignal(n) is not signal.SIG_IGN}


@contextlib.contextmanager
def held() -> Iterator[None]:
    """Defer signals: after an exception in the middle of an import, libraries may recurse or abort."""
    waiting: list[int] = []
    before = _hand_to(lambda number, _: waiting.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if waiting:
            signal.raise_signal(waiting[0])


@contextlib.contextmanager
def ended(how_to_go_on: Callable[[], str], *, speaks: bool = True) -> Iterator[None]:
    """Raise `Stopped` with advice on resuming after a signal; without `speaks`, exit silently.

    Lightning itself exits with code 1 on Ctrl-C.
    """
    try:
        if stop := arrived():  # a library swallowed the exception
            raise stop
        yield
    except (KeyboardInterrupt, SystemExit, Stopped) as stop:
        by_ctrl_c = isinstance(stop, KeyboardInterrupt) or isinstance(stop.__context__, KeyboardInterrupt)
        if not (by_ctrl_c or isinstance(stop, Stopped)):
            raise
        _hand_to(lambda *_: None)  # a second signal must not replace the message
        known = stop if isinstance(stop, Stopped) else Stopped(signal.SIGINT)
        if not speaks:
            sys.exit(code_of(known))
        raise known.saying(how_to_go_on()) from None


def code_of(stop: Stopped) -> int:
    """Return the exit code of a process ended by a signal, by shell convention."""
    return 128 + stop.signal


@contextlib.contextmanager
def interruptible(trainer: Trainer, how_to_go_on: Callable[[], str]) -> Iterator[None]:
    """Convert early termination of a fit or an evaluation into one message.

    Raises:
        Stopped: on a signal, with the resume command in the message.
        UserError: incompatible trainer settings.
    """
    from lightning.fabric.utilities.exceptions import MisconfigurationException

    try:
        with ended(how_to_go_on, speaks=trainer.is_global_zero):
            yield
    except MisconfigurationException as error:
        message = f"trainer: {error}"
        raise UserError(message) from error
