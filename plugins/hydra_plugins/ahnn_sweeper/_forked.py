"""Commands run in forks of a process with common imports, which is equivalent to a fresh start.

The fork server belongs to `multiprocessing` and forks while it has a single thread. Windows has no fork
server: there each job starts afresh. The server ignores signals that a scheduler sends to all processes, so
that it lives until its jobs have ended and their exit codes are known.
"""

from __future__ import annotations

import atexit
import multiprocessing
import os
import runpy
import signal
import sys
import threading
from collections.abc import Sequence
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from pathlib import Path

from ahnn.workers import end_with

if sys.platform == "win32":
    _context = multiprocessing.get_context("spawn")
else:
    _context = multiprocessing.get_context("forkserver")
_one_thread = threading.Lock()
"""Lock, since starting a process reaps ended processes, including one that another thread waits for."""


def serve(imports: Sequence[str]) -> None:
    """Preload modules in the server, which starts with the first job; missing ones are skipped."""
    _context.set_forkserver_preload(["hydra_plugins.ahnn_sweeper._held", *imports])


def start(program: str, arguments: list[str], log: Path, *, bound: bool = False) -> BaseProcess:
    """Start a command with its output in a file.

    Args:
        program: module name, as for `python -m`, or path of a script.
        arguments: command line arguments.
        log: file for standard output and standard error.
        bound: whether the command is killed when this process ends, and its output is appended to the file.
    """
    process = _context.Process(target=_run, args=(program, arguments, str(log), bound))
    with _one_thread:
        process.start()
    return process


def exit_code(process: BaseProcess) -> int:
    """Wait for a command and return its exit code, or the negative number of the signal that killed it."""
    wait([process.sentinel])
    with _one_thread:
        process.join()
    assert process.exitcode is not None
    return process.exitcode


def _run(program: str, arguments: list[str], log: str, bound: bool) -> None:
    """Run the command in the forked process, including its exit handlers."""
    from hydra_plugins.ahnn_sweeper._held import HANDLERS

    for number, handler in HANDLERS.items():
        signal.signal(number, handler)
    if bound:
        end_with(multiprocessing.parent_process())
    with open(log, "ab" if bound else "wb") as output:
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
    sys.argv = [program, *arguments]
    try:
        if os.path.isfile(program):
            runpy.run_path(program, run_name="__main__")
        else:
            runpy.run_module(program, run_name="__main__", alter_sys=True)
    except Exception as error:  # in Python's own format; `multiprocessing` would add its process name
        sys.stdout.flush()
        sys.excepthook(type(error), error, error.__traceback__)
        sys.exit(1)
    finally:
        atexit._run_exitfuncs()  # `multiprocessing` does this only since Python 3.14
