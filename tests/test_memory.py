"""What is left of memory, what is refused where it is not enough, and what becomes of freed memory."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from entry import SMALL, call

from ahnn.memory import available
from ahnn.training.normal_equations import memory_of, memory_of_parts

PAGES = """
import resource
import torch
from ahnn.memory import keep_freed

keep_freed()

def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

for count in (30, 10):
    before = faults()
    for _ in range(count):
        torch.ones(8_000_000, dtype=torch.float64)
print((faults() - before) * resource.getpagesize() / 8 / 8_000_000)
"""


@pytest.mark.skipif(not hasattr(os, "confstr"), reason="glibc alone keeps freed memory on request")
@pytest.mark.parametrize(("tuned", "tensors"), [({}, (0, 0.1)), ({"MALLOC_TRIM_THRESHOLD_": "0"}, (9, 11))])
@pytest.mark.sampled(2)
def test_tensors_take_the_pages_of_those_before_unless_the_user_tunes_it(tuned, tensors):
    run = subprocess.run(
        [sys.executable, "-c", PAGES], env=os.environ | tuned, capture_output=True, text=True, check=True
    )
    low, high = tensors
    assert low <= float(run.stdout) <= high  # pages that came anew, in tensors of ten


def account(root, **files):
    """A file system with these accounts of memory, in which `__` stands for a folder."""
    for name, text in files.items():
        path = root.joinpath(*name.split("__"))
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def test_memory_is_what_the_machine_and_every_control_group_around_have_left(tmp_path):
    account(tmp_path, proc__meminfo="MemTotal: 900 kB\nMemAvailable: 500 kB\n")
    assert available(tmp_path) == 512_000
    account(tmp_path, proc__self__cgroup="0::/job/step\n")
    group = tmp_path / "sys" / "fs" / "cgroup" / "job"
    (group / "step").mkdir(parents=True)
    (group / "step" / "memory.max").write_text("max\n")
    (group / "step" / "memory.stat").write_text("anon 5\nfile 100\n")
    assert available(tmp_path) == 512_000
    (group / "memory.max").write_text("300000\n")
    (group / "memory.stat").write_text("anon 1000\nfile 299000\n")  # cached files make way
    assert available(tmp_path) == 299_000
    account(tmp_path, proc__self__cgroup="3:cpu,memory:/a\n")
    old = tmp_path / "sys" / "fs" / "cgroup" / "memory" / "a"
    old.mkdir(parents=True)
    (old / "memory.limit_in_bytes").write_text("4000\n")
    (old / "memory.stat").write_text("total_rss 5000\n")
    assert available(tmp_path) == 0
    assert 0 < available(tmp_path / "nothing") <= os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def test_equations_are_at_least_the_arrays_that_are_there_at_once():
    count, rows = 1000, 200
    assert memory_of(count, rows) >= 4 * rows * count + 3 * 8 * count**2
    assert memory_of_parts(count) >= 8 * 8 * count**2


@pytest.mark.parametrize(
    ("given", "who"),
    [
        (["model.network.width=200"], "model.network: expected the equations for second-order steps on 41,"),
        (["network=paper"], "model.network: expected the equations for second-order steps on 1"),
        (["sensor=spring_states", "model.network.width=200"], "model.network: expected the equations"),
        (["data.batch_size=100000000", "data.windows_per_epoch=null"], "data.batch_size: expected the equa"),
    ],
)
def test_equations_beyond_memory_are_refused_before_anything_is_generated(
    given, who, tmp_path, capfd, monkeypatch
):
    monkeypatch.setattr("ahnn.memory.available", lambda: 24 * 10**9)
    own = {text.partition("=")[0] for text in given} | {"model.network.width"}
    kept = [text for text in SMALL if text.partition("=")[0] not in own]
    assert call("ahnn.train", "budget=smoke", *kept, *given, f"run={tmp_path / 'run'}") == 2
    err = capfd.readouterr().err
    assert err.startswith(f"ahnn: {who}")
    assert "of available memory; received" in err
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
