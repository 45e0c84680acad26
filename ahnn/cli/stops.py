"""What ends a training early, by the user's will or a scheduler's: one message and an exit code."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from ahnn.errors import Stopped, UserError

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
    """Return the signal that arrived since `listen`, if any: whatever fails after it fails because of it.

    An import that it interrupts may swallow the exception and fail in a way of its own.
    """
    return Stopped(_arrived[0]) if _arrived else None


def listen() -> None:
    """Let signals raise `KeyboardInterrupt` or `Stopped`, unless somebody has them ignored (nohup)."""
    if threading.current_thread() is not threading.main_thread():
        return
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _raise)


@contextlib.contextmanager
def held() -> Iterator[None]:
    """Let signals wait: an exception in the middle of an import leaves libraries that recurse or abort."""
    waiting: list[int] = []
    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is not signal.SIG_IGN:
                before[number] = signal.signal(number, lambda number, _: waiting.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if waiting:
            signal.raise_signal(waiting[0])


@contextlib.contextmanager
def ended(how_to_go_on: str) -> Iterator[None]:
    """Say how to go on where a signal ends work that keeps its state; "" leaves the message as it is."""
    try:
        yield
    except (KeyboardInterrupt, Stopped) as stop:
        number = _signal_of(stop)
        if number is None or not how_to_go_on:
            raise
        word = "Ctrl-C" if number == signal.SIGINT else number.name
        raise Stopped(number, f"stopped by {word}; {how_to_go_on}") from None


@contextlib.contextmanager
def interruptible(trainer: Trainer, how_to_go_on: Callable[[], str]) -> Iterator[None]:
    """Turn what ends a fit or an evaluation early into one message.

    Lightning answers Ctrl-C with an exit of its own, code 1.

    Raises:
        Stopped: with the command that resumes.
        UserError: settings of the trainer that do not go together.
    """
    from lightning.fabric.utilities.exceptions import MisconfigurationException

    try:
        yield
    except (KeyboardInterrupt, SystemExit, Stopped) as stop:
        number = _signal_of(stop)
        if number is None:
            raise
        if not trainer.is_global_zero:
            sys.exit(128 + number)  # of several processes, one speaks
        word = "Ctrl-C" if number == signal.SIGINT else number.name
        raise Stopped(number, f"stopped by {word}; {how_to_go_on()}") from None
    except MisconfigurationException as error:
        message = f"trainer: {error}"
        raise UserError(message) from error


def _signal_of(stop: BaseException) -> signal.Signals | None:
    """Return the signal behind an exception; None for an exit of somebody else's."""
    if isinstance(stop, Stopped):
        return stop.signal
    by_ctrl_c = isinstance(stop, KeyboardInterrupt) or isinstance(stop.__context__, KeyboardInterrupt)
    return signal.SIGINT if by_ctrl_c else None
