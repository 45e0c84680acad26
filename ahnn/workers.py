"""Tasks divided among processes of this machine or of a Ray cluster, and repeated if one is killed."""

from __future__ import annotations

import multiprocessing
import os
import re
import signal
import threading
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Literal, NamedTuple, TypeVar

from ahnn.errors import TrainingError, UserError
from ahnn.optional_libraries import library

Item = TypeVar("Item")
Result = TypeVar("Result")

STARTS = 4
"""Maximum number of times that a task starts, if its worker is killed each time."""
QUIET = {"RAY_DEDUP_LOGS": "0", "RAY_USAGE_STATS_ENABLED": "0", "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0"}
"""Environment variables of Ray: show every line of a worker, report nothing to Ray's developers."""


class Workers(NamedTuple):
    """Kind and number of workers.

    Attributes:
        engine: processes of this machine, or Ray.
        number: number of parallel tasks.
    """

    engine: Literal["processes", "ray"]
    number: int

    @classmethod
    def of(cls, text: str | int) -> Workers:
        """Parse workers: `2` means processes of this machine, `ray:2` means Ray tasks; raises UserError."""
        found = re.fullmatch(r"(ray:)?([1-9]\d{0,4})", str(text))
        if found is None:
            message = f"workers: expected a number, such as 2, or ray:2; received {text!r}"
            raise UserError(message)
        return cls("ray" if found[1] else "processes", int(found[2]))

    def require_installed(self) -> None:
        """Raise UserError if the engine is not installed; called before anything is written."""
        if self.engine == "ray":
            library("ray", "ray", "ray", "workers")

    def map(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """Return the results of a module-level function for each of the items, in their order.

        A task whose worker is killed starts again in another worker, at most `STARTS` times in all.

        Raises:
            UserError: Ray is missing; exceptions of a task are raised again.
            TrainingError: the worker of a task was killed each time.
        """
        mapped = _on_ray if self.engine == "ray" else _on_processes
        return mapped(function, items, self.number)


def connected(cpus: int, **options: Any) -> Any:
    """Return the module ray, connected to the cluster of `ray start`, or to a new cluster of this process.

    Args:
        cpus: number of processors of a new cluster.
        options: further arguments of `ray.init`.

    Raises:
        UserError: Ray is not installed, or its cluster does not answer.
    """
    os.environ |= {name: os.environ.get(name, value) for name, value in QUIET.items()}
    ray = library("ray", "ray", "ray", "workers")
    if ray.is_initialized():
        return ray
    handler = signal.getsignal(signal.SIGTERM)
    given = {"logging_level": "warning", **options}
    try:
        try:
            ray.init(**{"num_cpus": cpus, "include_dashboard": False, **given})
        except ValueError:  # a cluster exists and has its own number of processors
            ray.init(**given)
    except ConnectionError as error:
        said = " ".join(str(error).split())
        message = f"workers: expected a Ray cluster at RAY_ADDRESS or from `ray start`; received: {said}"
        raise UserError(message) from error
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, handler)  # Ray replaced it by one without a message
    return ray


def _on_ray(function: Callable[[Item], Result], items: Sequence[Item], count: int) -> list[Result]:
    ray = connected(count)
    task = ray.remote(num_cpus=1, max_retries=STARTS - 1)(_at).remote
    waiting, running, found = deque(enumerate(items)), {}, {}
    while waiting or running:
        while waiting and len(running) < count:
            number, item = waiting.popleft()
            running[task(os.getcwd(), function, item)] = number
        (done,), _ = ray.wait([*running], num_returns=1)
        try:
            found[running.pop(done)] = ray.get(done)
        except ray.exceptions.RayTaskError as error:
            raise error.cause from None
        except ray.exceptions.WorkerCrashedError as error:
            raise _killed() from error
    return [found[number] for number in range(len(items))]


def _at(folder: str, function: Callable[[Item], Result], item: Item) -> Result:
    """Return the result of a task, run in the folder of the command, which all machines share."""
    os.chdir(folder)
    return function(item)


def _on_processes(function: Callable[[Item], Result], items: Sequence[Item], count: int) -> list[Result]:
    found: dict[int, Result] = {}
    for _ in range(STARTS):
        spawn, left = multiprocessing.get_context("spawn"), [k for k in range(len(items)) if k not in found]
        with ProcessPoolExecutor(min(count, len(left)), spawn, _end_with_parent) as pool:
            tasks = {k: pool.submit(function, items[k]) for k in left}
            try:
                found |= {k: task.result() for k, task in tasks.items()}
                return [found[k] for k in range(len(items))]
            except BrokenProcessPool:  # a worker was killed, and the pool ended all others
                ended = {k: task for k, task in tasks.items() if task.done() and not task.exception()}
                found |= {k: task.result() for k, task in ended.items()}
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                for child in multiprocessing.active_children():
                    child.terminate()
                raise
    raise _killed()


def _killed() -> TrainingError:
    message = (
        f"workers: expected workers that keep running; received one that was killed {STARTS} times in a row"
    )
    return TrainingError(
        f"{message}. Check that the machine has enough free memory, then run the command again"
    )


def _end_with_parent() -> None:
    """Ignore Ctrl-C, which the parent handles, and end as soon as the parent ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with(multiprocessing.parent_process())


def end_with(process: Any) -> None:
    """End this process by SIGKILL as soon as another process of `multiprocessing` has ended."""

    def watch() -> None:
        process.join()
        os.kill(os.getpid(), getattr(signal, "SIGKILL", signal.SIGTERM))

    threading.Thread(target=watch, name="end-with-parent", daemon=True).start()
