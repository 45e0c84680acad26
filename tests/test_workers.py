"""Tasks of several processes: order, kills, errors, and an end with their parent."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ahnn.errors import TrainingError, UserError
from ahnn.workers import STARTS, Workers

TWO = Workers.of(2)


def squared(task):
    """Square a number, and note it; a task with a mark kills its process as long as the mark is missing."""
    number, folder, mark = task
    with (folder / "begun").open("a") as file:
        file.write(f"{number}\n")
    if mark is not None and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number**2


def refused(number):
    message = f"number: expected an even one; received {number}"
    raise UserError(message)


def killed(number):
    del number
    os.kill(os.getpid(), signal.SIGKILL)


def asleep(place):
    Path(place).write_text(str(os.getpid()))
    time.sleep(60.0)


def test_workers_are_a_number_of_processes_or_of_tasks_of_ray():
    assert Workers.of(2) == Workers.of("2") == ("processes", 2)
    assert Workers.of("ray:16") == ("ray", 16)
    for wrong in (0, -1, "ray", "ray:0", "ray:", "slurm:2", "2.0", "2 "):
        with pytest.raises(UserError, match="workers: expected a number, such as 2, or ray:2; received"):
            Workers.of(wrong)


def test_results_come_in_order_once_though_a_worker_is_killed(tmp_path):
    tasks = [(number, tmp_path, tmp_path / "mark" if number == 1 else None) for number in range(5)]
    assert TWO.map(squared, tasks) == [0, 1, 4, 9, 16]
    begun = sorted(map(int, (tmp_path / "begun").read_text().split()))
    assert begun.count(1) >= 2  # before the kill and after it
    assert {*begun} == {*range(5)}


def test_the_error_of_a_task_is_that_of_the_command():
    with pytest.raises(UserError, match="number: expected an even one; received 3"):
        TWO.map(refused, [3, 5])


def test_a_task_that_is_killed_each_time_ends_with_a_message():
    with pytest.raises(TrainingError, match=f"received one that was killed {STARTS} times in a row"):
        TWO.map(killed, [0])


def test_workers_end_when_their_parent_is_killed(tmp_path):
    places = [str(tmp_path / name) for name in "ab"]
    code = f"from test_workers import TWO, asleep; TWO.map(asleep, {places})"
    program = tmp_path / "program.py"
    program.write_text(f"if __name__ == '__main__':\n    {code}\n")
    env = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    parent = subprocess.Popen([sys.executable, str(program)], env=env)
    while not all(Path(place).exists() and Path(place).read_text() for place in places):
        assert parent.poll() is None
        time.sleep(0.01)
    parent.kill()
    parent.wait()
    limit = time.monotonic() + 30.0
    for place in places:
        while alive(int(Path(place).read_text())):
            assert time.monotonic() < limit
            time.sleep(0.01)


def alive(pid):
    """Whether a process exists and is no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False
