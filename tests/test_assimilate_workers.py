"""`python -m ahnn.assimilate objects=COLUMN workers=2`: one output, as of one worker, also after kills."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from test_assimilate_objects import COMMAND, GIVEN, assimilate, place, rows_of

from ahnn.workers import Workers

__all__ = ["place"]
EVERY = [*GIVEN, "every=40"]
MADE = ["output=all.csv", "state=parts", "states=last.csv"]


@pytest.fixture
def inside(monkeypatch):
    """Workers that are calls of this process, in turn."""
    monkeypatch.setattr(Workers, "map", lambda _, function, items: [function(item) for item in items])


def spoil():
    """Break a line, leave one object without a start, and begin another at the centre of the Earth."""
    lines = Path("fixes.csv").read_text().splitlines(keepends=True)
    lines[5] = "never,S1,1,2,3\n"
    lines[9] = "30,S9,1,2,3\n"
    Path("fixes.csv").write_text("".join(lines))
    head, *starts = Path("starts.csv").read_text().splitlines()
    starts[2] = f"S2,0,1e-300,0,0,0,0,0,{starts[2].split(',', 8)[8]}"
    Path("starts.csv").write_text("\n".join([head, *starts]) + "\n")


@pytest.mark.usefixtures("place", "inside")
@pytest.mark.parametrize(
    ("workers", "suffix"), [("2", "csv"), pytest.param("3", "jsonl", marks=pytest.mark.slow)]
)
def test_workers_write_what_one_does_and_a_broken_object_harms_no_other(workers, suffix, caplog):
    assert assimilate(*EVERY, f"output=sound.{suffix}") == 0
    spoil()
    assert assimilate(*EVERY, f"output=one.{suffix}", "states=one.last.csv") == 0
    said = [text for text in caplog.messages if "lines: " in text or "objects, " in text or "NIS" in text]
    assert "1 bad" in caplog.text
    assert "4 objects, 1 of them lost" in caplog.text
    caplog.clear()
    given = f"output=all.{suffix}", "states=all.last.csv", "state=parts", f"workers={workers}"
    assert assimilate(*EVERY, *given) == 0
    assert [text for text in caplog.messages if text in said] == said[-3:]
    assert caplog.text.count("object S9 has no start: ignored") == 1
    assert caplog.text.count("object S2: ") == 1
    for name in (suffix, "last.csv"):
        assert Path(f"all.{name}").read_bytes() == Path(f"one.{name}").read_bytes()
    tables = [Path(f"{name}.{suffix}").read_text().splitlines() for name in ("sound", "all")]
    sound, broken = ([row for row in table if "S3" in row] for table in tables)
    assert len(sound) == 30
    assert broken == sound


@pytest.mark.slow
@pytest.mark.usefixtures("place", "inside")
def test_the_same_command_reads_on_and_replaces_its_output(caplog):
    whole = Path("fixes.csv").read_text().splitlines(keepends=True)
    Path("fixes.csv").write_text("".join(whole[:50]))
    assert assimilate(*EVERY, *MADE, "workers=2") == 0
    assert len(rows_of("all.csv")) == 49
    Path("fixes.csv").write_text("".join(whole))
    assert assimilate(*EVERY, *MADE, "workers=2") == 0
    assert caplog.messages.count("resuming after line 50") == 2
    assert assimilate(*EVERY, "output=one.csv", "states=one.last.csv") == 0
    assert Path("all.csv").read_bytes() == Path("one.csv").read_bytes()
    assert Path("last.csv").read_bytes() == Path("one.last.csv").read_bytes()


@pytest.mark.slow
@pytest.mark.usefixtures("place", "inside")
def test_an_array_of_shards_is_joined_by_workers(caplog):
    Path("parts").mkdir()
    for k in (1, 2):
        assert assimilate(*EVERY, f"shard={k}/2", f"output=parts/{k}.csv", f"state=parts/{k}.state") == 0
    assert assimilate(*EVERY, *MADE, "workers=2") == 0
    assert caplog.messages.count("resuming after line 121") == 2
    assert assimilate(*EVERY, "output=one.csv") == 0
    assert Path("all.csv").read_bytes() == Path("one.csv").read_bytes()


@pytest.mark.slow
@pytest.mark.usefixtures("place", "inside")
def test_more_workers_than_objects_and_one_start_for_all():
    assert assimilate(*EVERY, "output=one.csv") == 0
    assert assimilate(*EVERY, *MADE, "workers=64") == 0
    assert Path("all.csv").read_bytes() == Path("one.csv").read_bytes()
    assert not Path("parts/4.csv").exists()  # two of the four objects have the same hash modulo 4
    common = [*GIVEN[:3], "start=[1,-3145,-6173,10,0,0]", "start_sd=[30,0.1]", "gate=none"]
    assert assimilate(*common, "output=common.csv", "states=common.last.csv") == 0
    given = "output=many.csv", "state=many", "states=many.last.csv", "workers=3"
    assert assimilate(*common, *given) == 0
    assert Path("many.csv").read_bytes() == Path("common.csv").read_bytes()
    assert Path("many.last.csv").read_bytes() == Path("common.last.csv").read_bytes()


MISTAKES = {
    "workers=0": "workers: expected a number, such as 2, or ray:2; received 0",
    "output=-": "output: expected a .csv or .jsonl FILE with workers=2; received -",
    "output=all.parquet": "output: expected a .csv or .jsonl FILE with workers=2; received all.parquet",
    "state=null": "state: expected a FOLDER for the states of the workers with workers=2; received none",
    "state=starts.csv": "state: expected a folder with workers=2; received starts.csv, a file",
    "measurements=-": "measurements: expected a FILE that every worker reads with workers=2; received -",
    "shard=1/2": "shard: expected none, since workers have one each with workers=2; received 1/2",
    "states=last.txt": "output: expected a .csv, .parquet, .oem or .xml file",
    "output=fixes.csv": "received fixes.csv",
    "objects=null": "workers: expected objects=COLUMN with workers=2; received no objects",
}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("words", MISTAKES)
def test_a_mistake_is_one_message_and_leaves_nothing(words, place, capsys):
    assert assimilate(*GIVEN, "output=all.csv", "state=parts", "workers=2", words) == 2
    (line,) = [text for text in capsys.readouterr().err.splitlines() if "expected" in text]
    assert MISTAKES[words] in line
    assert sorted(path.name for path in place.iterdir()) == ["fixes.csv", "starts.csv"]


@pytest.mark.slow
@pytest.mark.usefixtures("place", "inside")
def test_what_others_changed_is_neither_joined_nor_replaced(capsys):
    assert assimilate(*EVERY, *MADE, "workers=2") == 0
    assert assimilate(*EVERY, *MADE, "workers=1") == 2
    assert (
        "start: expected the 1 objects of parts/1.state; received different ones" in capsys.readouterr().err
    )
    text = Path("parts/1.csv").read_text()
    Path("parts/1.csv").write_text(text[: text.rindex("\n", 0, -1) + 1])
    assert assimilate(*EVERY, *MADE, "workers=2") == 2
    assert "output: expected parts/1.csv unchanged" in capsys.readouterr().err
    Path("parts/1.csv").write_text(text)
    with Path("all.csv").open("a") as file:
        file.write("mine\n")
    assert assimilate(*EVERY, *MADE, "workers=2") == 2
    assert "received all.csv, a file that is neither" in capsys.readouterr().err
    assert Path("all.csv").read_text().endswith("mine\n")


def test_ray_that_is_not_installed_is_one_message(place, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "ray", None)
    assert assimilate(*GIVEN, "output=all.csv", "state=parts", "workers=ray:2") == 2
    message = "workers: expected the package ray; received none. Install it with pip install 'ahnn[ray]'"
    assert message in capsys.readouterr().err
    assert sorted(path.name for path in place.iterdir()) == ["fixes.csv", "starts.csv"]


def writers(path):
    """Processes that have a file open."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if any(os.path.samefile(entry, path) for entry in (process / "fd").iterdir()):
                found.append(int(process.name))
        except OSError:  # it is gone, or is not ours
            continue
    return found


@pytest.mark.slow
@pytest.mark.usefixtures("place")
@pytest.mark.parametrize("workers", ["2", "ray:2"])
def test_nothing_is_lost_or_doubled_when_a_worker_is_killed(workers):
    if workers.startswith("ray"):
        pytest.importorskip("ray", reason="the extra `ray` is needed")
    every = [*GIVEN, "every=400"]
    rows = Path("fixes.csv").read_text().splitlines(keepends=True)
    later = [f"{450.0 + 0.01 * k},S{k % 4},,,\n" for k in range(1, 3000)]  # predictions, seconds of them
    Path("fixes.csv").write_text("".join([*rows, *later]))
    assert assimilate(*every, "output=one.csv", "states=one.last.csv") == 0
    command = [sys.executable, "-m", "ahnn.assimilate", *COMMAND, *every, *MADE, f"workers={workers}"]
    running = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    part = Path("parts/1.csv")
    while not (part.exists() and part.stat().st_size > 100_000):
        assert running.poll() is None
        time.sleep(0.001)
    killed = [pid for pid in writers(part) if pid != running.pid]
    for pid in killed:
        os.kill(pid, signal.SIGKILL)
    assert running.wait() == 0
    assert killed
    assert Path("all.csv").read_bytes() == Path("one.csv").read_bytes()
    assert Path("last.csv").read_bytes() == Path("one.last.csv").read_bytes()
