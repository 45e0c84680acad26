"""What Windows lacks is imitated: its calls and signals are taken away, and byte locks stand for flock."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
WINDOWS = """
import collections, fcntl, os, shutil, signal, sys, types
import filelock, hydra, lightning, matplotlib.pyplot, multiprocessing, optuna, sqlalchemy
import torch.utils.tensorboard

flock = fcntl.flock
def locking(descriptor, mode, count):
    assert os.lseek(descriptor, 0, os.SEEK_CUR) > 2**30  # a byte that no reader needs
    try:
        flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise PermissionError(13, "denied") from None

usage = collections.namedtuple("usage", "total used free")
shutil.disk_usage = lambda path: usage(10**12, 0, 10**12)
for name in ("fcntl", "grp", "pwd", "resource", "termios"):
    sys.modules[name] = None
sys.modules["msvcrt"] = types.SimpleNamespace(locking=locking, LK_NBLCK=2)
for name in ("SIGHUP", "SIGPIPE"):
    delattr(signal, name)
for name in ("fork", "getpgid", "getuid", "killpg", "O_NOFOLLOW", "pread", "register_at_fork"):
    delattr(os, name)
for name in ("sched_getaffinity", "setsid", "statvfs", "sysconf"):
    delattr(os, name)
sys.platform = "win32"
"""
IMPORTS = """
import importlib, pathlib
for base, rooms in ((sys.argv[1], ("ahnn",)), (sys.argv[1] + "/plugins", ("ahnn_plugins", "hydra_plugins"))):
    for path in (p for room in rooms for p in pathlib.Path(base, room).rglob("*.py") if p.stem != "__main__"):
        importlib.import_module(".".join(path.relative_to(base).with_suffix("").parts).removesuffix(".__init__"))
"""
FILES = """
from pathlib import Path
from ahnn.files import claimed, write_atomically, write_cached
from ahnn.locks import lock
from ahnn.memory import available

for content in (b"a\\n", b"b\\n"):
    write_atomically(Path("mine.txt"), content)
write_cached(Path("cache/of.bin"), b"c")
assert Path("mine.txt").read_bytes() == b"b\\n" and not list(Path().rglob("*.tmp"))
with claimed(Path()), open("held", "ab") as first, open("held", "ab") as second:
    lock(first)
    try:
        lock(second, wait=False)
    except BlockingIOError:
        print("held")
with open("held", "ab") as third:
    lock(third)
assert available() > 2**30
"""
TRAIN = """
import runpy
sys.argv = ["ahnn.train", "budget=smoke", "trainer.max_epochs=1", "run=out"]
runpy.run_module("ahnn.train", run_name="__main__", alter_sys=True)
"""


def run(place, code):
    done = subprocess.run(
        [sys.executable, "-c", WINDOWS + code, str(ROOT)],
        cwd=place,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_files_are_written_and_locked(tmp_path):
    assert run(tmp_path, FILES) == "held\n"


@pytest.mark.slow
@pytest.mark.parametrize("code", [IMPORTS, TRAIN], ids=["every module", "a training"])
def test_nothing_else_is_missed(tmp_path, code):
    run(tmp_path, code)


def test_leak_reports_of_triton_are_not_shown(tmp_path):
    code = """
import atexit, os, sys
from ahnn.cli.guard import guard

class Leak:
    def __del__(self, write=os.write):
        write(2, b"leaked\\n")

def work():
    sys.modules["triton"] = leak = Leak()
    atexit.register(lambda: print("an exit handler", file=sys.stderr))

sys.exit(guard(work))
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stderr == "an exit handler\n"
