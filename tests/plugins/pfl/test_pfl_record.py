"""The record of a grid: jobs that end together lose no line, torn lines harm no other."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

from ahnn_plugins.pfl.record import Record

WRITER = """
import sys
from pathlib import Path
import importlib.util
spec = importlib.util.spec_from_file_location("record", sys.argv[1])
record = importlib.util.module_from_spec(spec)
spec.loader.exec_module(record)
for k in range(200):
    record.Record(Path(sys.argv[2]), "spring").append(f"{sys.argv[3]}-{k}", 0.5)
"""


def test_concurrent_jobs_lose_nothing(tmp_path: Path):
    from ahnn_plugins.pfl import record

    path = tmp_path / "record.jsonl"
    command = [sys.executable, "-c", WRITER, str(record.__file__), str(path)]
    jobs = [subprocess.Popen([*command, str(k)]) for k in range(4)]
    assert [job.wait() for job in jobs] == [0] * 4
    assert Record(path, "spring").finals() == [0.5] * 800


def test_a_torn_line_is_skipped_and_not_continued(tmp_path: Path):
    path = tmp_path / "record.jsonl"
    record = Record(path, "spring")
    record.append("a", 1.0)
    with path.open("a") as file:
        file.write('{"group": "spring", "run": "b", "lo')
    assert record.finals() == [1.0]
    record.append("c", 2.0)
    assert record.finals() == [1.0, 2.0]


def test_groups_are_apart_and_non_finite_losses_left_out(tmp_path: Path):
    record = Record(tmp_path / "record.jsonl", "spring")
    assert record.finals() == []
    record.append("a", math.nan)
    record.append("b", 3.0)
    Record(record.path, "orbit").append("c", 4.0)
    assert record.finals() == [3.0]
