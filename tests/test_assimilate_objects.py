"""`python -m ahnn.assimilate objects=COLUMN`: fixes of several satellites, their states, kills, mistakes."""

from __future__ import annotations

import csv
import multiprocessing
import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from entry import call, forked

import ahnn
from ahnn.data.files import Ephemeris, instant, read_oem, write_oem

RUN = ahnn.load("molniya_mechanical")
COUNT, FIXES = 4, 30
FIRST = torch.tensor([0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0], dtype=torch.float64)
STARTS = FIRST + torch.arange(COUNT, dtype=torch.float64)[:, None] * torch.tensor(
    [9.0, 40.0, 20.0, 0.01, 0.0, 0.0]
)
ORBITS = RUN.rollout(STARTS, FIXES, 15.0)
NOISE = 0.05 * torch.randn(
    COUNT, FIXES + 1, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64
)
GIVEN = ["measurements=fixes.csv", "objects=sat", "measurement.sd=0.05", "start=starts.csv"]
COMMAND = ["pretrained=molniya_mechanical", "plugins.ukf.process_noise=[1e-3,1e-5]"]


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with fixes of all satellites in turns, and their starts."""
    fixes = ORBITS[..., :3] + NOISE
    rows = ["time,sat,x,y,z"]
    for k in range(1, FIXES + 1):
        rows += [f"{15.0 * k},S{b},{','.join(map(repr, fixes[b, k].tolist()))}" for b in range(COUNT)]
    (tmp_path / "fixes.csv").write_text("\n".join(rows) + "\n")
    head = "id,t [s],x [km],y [km],z [km],vx [km/s],vy [km/s],vz [km/s],sd_x,sd_y,sd_z,sd_vx,sd_vy,sd_vz"
    rows = [
        f"S{b},0,{','.join(map(repr, STARTS[b].tolist()))},0.1,0.1,0.1,1e-4,1e-4,1e-4" for b in range(COUNT)
    ]
    (tmp_path / "starts.csv").write_text("\n".join([head, *rows]) + "\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def assimilate(*arguments):
    """Call the command."""
    return call("ahnn.assimilate", *COMMAND, *arguments)


def rows_of(name):
    """The rows of a table."""
    with Path(name).open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def forks(monkeypatch):
    """Workers that are copies of this process, with its imports; tests/test_workers.py has new ones."""
    fork = multiprocessing.get_context("fork")
    monkeypatch.setattr(multiprocessing, "get_context", lambda _: fork)


@pytest.mark.usefixtures("forks")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize("more", [[], ["workers=2", "state=kept"]])
def test_objects_beyond_the_training_data_are_counted_and_the_farthest_is_named(place, caplog, more):
    """Two of them at 1.2 and 2 times the radius of the perigees, each with one measurement."""
    path, fixes = place / "starts.csv", ["time,sat,x,y,z"]
    lines = path.read_text().splitlines()
    for b, share in enumerate((1.0, 1.2, 1.0, 2.0)):
        far = [share * x for x in STARTS[b, :3].tolist()]
        lines[b + 1] = ",".join((f"S{b},0", *map(repr, far), *lines[b + 1].split(",")[5:]))
        fixes.append(",".join((f"0,S{b}", *map(repr, far))))
    path.write_text("\n".join(lines) + "\n")
    (place / "fixes.csv").write_text("\n".join(fixes) + "\n")
    assert assimilate(*GIVEN, "output=track.csv", *more) == 0
    (said,) = [text for text in caplog.messages if text.startswith("novelty")]
    far = float(RUN.novelty(STARTS[3] * torch.tensor([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])))
    assert f"of 2 of 4 objects lie beyond the training data, that of S3 {far:.3g} times as far" in said


@pytest.mark.usefixtures("place")
def test_objects_are_as_in_commands_of_their_own_and_their_states_are_starts(caplog):
    assert assimilate(*GIVEN, "output=track.csv", "states=last.csv", "every=50") == 0
    assert "120 lines: 120 taken" in caplog.messages
    assert "4 objects, 0 of them lost" in caplog.messages
    rows = [row for row in rows_of("track.csv") if row["object"] == "S2"]
    lines = Path("fixes.csv").read_text().splitlines()
    own = ["time,x,y,z", *(line.replace(",S2,", ",") for line in lines if ",S2," in line)]
    Path("own.csv").write_text("\n".join(own) + "\n")
    start = [f"start={STARTS[2].tolist()}", "start_sd=[0.1,1e-4]"]
    assert assimilate("measurements=own.csv", "measurement.sd=0.05", *start, "output=own.out") == 0
    numbers = [name for name in rows[0] if name.startswith(("x", "y", "z", "v", "nis", "inn"))]
    for one, other in zip(rows, rows_of("own.out"), strict=True):
        assert [float(one[n]) for n in numbers] == pytest.approx([float(other[n]) for n in numbers], rel=1e-9)
    last = rows_of("last.csv")
    assert [row["id"] for row in last] == ["S0", "S1", "S2", "S3"]
    assert float(last[2]["x [km]"]) == float(rows[-1]["x"])
    assert float(last[2]["sd_x [km]"]) == pytest.approx(float(rows[-1]["cov_x_x"]) ** 0.5, rel=1e-12)
    for start in ("last", "track"):
        asked = [COMMAND[0], f"start={start}.csv", "duration=60", f"output=from_{start}.csv"]
        assert call("ahnn.predict", *asked) == 0
        caplog.clear()
        assert assimilate(*GIVEN[:3], f"start={start}.csv", f"output=again_{start}.csv") == 0
        assert "120 lines: 116 late, 4 taken" in caplog.messages  # what was measured is before these starts
        assert "111 more lines late, up to line 117" in caplog.messages
    one, other = (rows_of(f"from_{start}.csv") for start in ("last", "track"))
    assert len(one) == 2 * COUNT
    for of_last, of_track in zip(one, other, strict=True):  # correlations and all
        assert (of_last["id"], of_last["t [s]"]) == (of_track["id"], of_track["t [s]"])
        for name in ("x [km]", "vz [km/s]", "sd_x [km]", "sd_vz [km/s]"):
            assert float(of_track[name]) == pytest.approx(float(of_last[name]), rel=1e-9)


@pytest.mark.usefixtures("place")
@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_estimates_have_epochs_where_time_zero_has_one(kind):
    epoch = "epoch=2024-03-01T12:00:00"
    assert assimilate(*GIVEN, epoch, f"output=track.{kind}") == 0
    if kind == "csv":
        rows = rows_of("track.csv")
    else:
        rows = pytest.importorskip("pyarrow.parquet").read_table("track.parquet").to_pylist()
    assert list(rows[0])[:4] == ["line", "object", "time", "epoch"]
    assert float(rows[COUNT]["time"]) == 30.0
    assert rows[COUNT]["epoch"] == "2024-03-01T12:00:30.000"


@pytest.mark.usefixtures("place")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_killed_command_goes_on_with_the_same_bytes():
    names = ["output=parts.csv", "state=parts.state", "states=parts.last.csv"]
    assert (
        assimilate(*GIVEN, "every=7", "output=whole.csv", "state=whole.state", "states=whole.last.csv") == 0
    )
    running = forked("ahnn.assimilate", *COMMAND, *GIVEN, "every=7", *names)
    while os.waitpid(running, os.WNOHANG) == (0, 0):
        if Path("parts.csv").exists() and Path("parts.csv").stat().st_size > 9000:
            os.kill(running, signal.SIGKILL)
            os.waitpid(running, 0)
            break
        time.sleep(0.001)
    assert assimilate(*GIVEN, "every=7", *names) == 0
    for name in ("csv", "last.csv"):
        assert Path(f"parts.{name}").read_bytes() == Path(f"whole.{name}").read_bytes()


MISTAKES = {
    "objects=satt": "objects: expected the name of a column; received 'satt'; did you mean 'sat'?",
    "objects=body": "objects: expected the name of a column; received 'body'; it takes time, sat, x, y, z",
    "objects=time": "objects: expected a column other than",
    "watch=true": "watch: expected none with objects=sat; received one",
    "oem=a.oem": "oem: expected none with objects=sat; received one",
    "states=out.csv": "received one path twice",
    "states=last.txt": "output: expected a .csv, .parquet, .oem or .xml file",
    "plugins=enkf": "process: expected a Gaussian filter, such as ukf or ekf; received enkf",
}


@pytest.mark.parametrize("words", MISTAKES)
def test_a_mistake_is_one_message_and_leaves_nothing(place, capsys, words):
    given = [text for text in GIVEN if text.partition("=")[0] != words.partition("=")[0]]
    command = [text.replace(".ukf.", ".enkf.") if "enkf" in words else text for text in COMMAND]
    assert call("ahnn.assimilate", *command, *given, "output=out.csv", words) == 2
    (line,) = [text for text in capsys.readouterr().err.splitlines() if "expected" in text or "twice" in text]
    assert MISTAKES[words] in line
    assert sorted(path.name for path in place.iterdir()) == ["fixes.csv", "starts.csv"]


@pytest.mark.usefixtures("place")
def test_states_without_objects_are_refused(capsys):
    assert assimilate(GIVEN[0], *GIVEN[2:], "states=a.csv") == 2
    assert "expected objects=COLUMN with" in capsys.readouterr().err


@pytest.mark.usefixtures("place")
def test_shards_are_together_what_one_worker_does_bit_for_bit(caplog, capsys):
    caplog.set_level("INFO", "ahnn")
    lines = Path("fixes.csv").read_text().splitlines(keepends=True)
    lines[5] = "never,S1,1,2,3\n"
    Path("fixes.csv").write_text("".join(lines))
    assert assimilate(*GIVEN, "output=whole.csv", "states=last.csv") == 0
    assert "1 bad" in caplog.text
    parts, states, bad = [], [], 0
    for k in (1, 2):
        caplog.clear()
        made = f"output=part-{k}.csv", f"states=last-{k}.csv", f"state=part-{k}.state"
        assert assimilate(*GIVEN, f"shard={k}/2", *made) == 0
        head, *rows = Path(f"part-{k}.csv").read_text().splitlines()
        parts += rows
        states += Path(f"last-{k}.csv").read_text().splitlines()[1:]
        bad += "1 bad" in caplog.text
    assert bad == 1
    assert len(rows) not in (0, len(parts))
    whole = Path("whole.csv").read_text().splitlines()
    assert [head, *sorted(parts, key=lambda row: int(row.partition(",")[0]))] == whole
    assert sorted(states) == sorted(Path("last.csv").read_text().splitlines()[1:])
    assert assimilate(*GIVEN, "shard=1/2", *made) == 2
    assert (
        "start: expected the 3 objects of part-2.state; received different objects" in capsys.readouterr().err
    )


@pytest.mark.usefixtures("place")
def test_what_is_no_shard_is_refused(capsys):
    for wrong in ("0/2", "3/2", "1/2/3", "a/b"):
        assert assimilate(*GIVEN, f"shard={wrong}") == 2
        assert "shard: expected NUMBER/WORKERS, such as 2/8" in capsys.readouterr().err
    assert assimilate(*GIVEN, "shard=7/64") == 2
    assert "shard: expected at least one of the 4 objects in the start" in capsys.readouterr().err


@pytest.mark.parametrize("objects", [True, False])
@pytest.mark.parametrize(("factor", "said"), [(1000.0, "1000"), (1e-3, "1/1000"), (1.5, None)])
def test_measurements_in_another_unit_are_suspected_by_their_factor(place, objects, factor, said, capsys):
    head, *rows = (place / "fixes.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows if objects or ",S2," in row]
    wrong = [[*row[:2], *(repr(factor * float(cell)) for cell in row[2:])] for row in cells]
    kept = [row if objects else [row[0], *row[2:]] for row in wrong]
    head = head if objects else head.replace(",sat", "")
    (place / "wrong.csv").write_text("\n".join([head, *(",".join(row) for row in kept)]) + "\n")
    start = [f"start={STARTS[2].tolist()}", "start_sd=[0.1,1e-4]"]
    given = GIVEN[1:] if objects else [GIVEN[2], *start]
    assert assimilate("measurements=wrong.csv", *given, "output=out.csv", "plugins.ukf.patience=1000") == 3
    (line,) = [text for text in capsys.readouterr().err.splitlines() if "usable line" in text]
    assert "rejected. Check the units of the measurements, or set start=" in line
    question = f". The measured x, y, z are about {said} times the predicted values: is the unit right?"
    assert line.endswith(question) == (said is not None)


def test_the_factor_of_a_unit_is_that_before_the_gate_reopened(place, capsys):
    """Afterwards the predictions are near the wrong values."""
    head, *lines = (place / "fixes.csv").read_text().splitlines()
    cells = [row.split(",") for row in lines if ",S2," in row]
    wrong = [",".join([row[0], *(repr(1e-3 * float(cell)) for cell in row[2:])]) for row in cells]
    (place / "wrong.csv").write_text("\n".join([head.replace(",sat", ""), *wrong]) + "\n")
    start = [f"start={STARTS[2].tolist()}", "start_sd=[0.1,1e-4]"]
    assert (
        assimilate("measurements=wrong.csv", GIVEN[2], *start, "output=out.csv", "plugins.ukf.patience=5")
        == 3
    )
    assert (
        "x, y, z are about 1/1000 times the predicted values: is the unit right?" in capsys.readouterr().err
    )


def test_a_start_far_from_all_measurements_is_named(place, caplog):
    path = place / "starts.csv"
    lines = path.read_text().splitlines()
    lines[3] = lines[3].replace(repr(float(STARTS[2, 1])), repr(float(STARTS[2, 1]) + 500.0))
    path.write_text("\n".join(lines) + "\n")
    assert assimilate(*GIVEN, "output=out.csv", "plugins.ukf.patience=3") == 0
    (said,) = [text for text in caplog.messages if "frame, unit and time" in text]
    assert said.startswith("object S2: all its measurements before were rejected")


@pytest.mark.usefixtures("place", "forks")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_names_of_many_objects_pass_from_their_starts_to_their_states():
    about = "EARTH", "EME2000", "UTC", instant("2024-03-01T12:00:00", utc=True), np.zeros(1)
    starts = [Ephemeris(f"S{b}", f"NAME {b}", *about, STARTS[b : b + 1].numpy()) for b in range(COUNT)]
    write_oem("starts.oem", starts)
    given = [*GIVEN[:3], "start=starts.oem", "start_sd=[0.1,1e-4]", "epoch=2024-03-01T12:00:00"]
    for shards in ([], ["workers=2", "state=parts"]):
        made = [f"output=track{len(shards)}.csv", f"states=last{len(shards)}.oem"]
        assert assimilate(*given, *made, *shards) == 0
        found = [one for b in range(COUNT) for one in read_oem(f"last{len(shards)}_S{b}.oem")]
        assert [(one.object_id, one.object_name) for one in found] == [
            (f"S{b}", f"NAME {b}") for b in range(COUNT)
        ]
        assert "objects:\n  S0: NAME 0\n" in Path(f"track{len(shards)}.yaml").read_text()
    asked = [COMMAND[0], "start=track0.csv", "duration=60", "output=ahead.oem", "frame=[EME2000,EARTH,UTC]"]
    assert call("ahnn.predict", *asked) == 0
    for b in range(COUNT):
        assert [one.object_name for one in read_oem(f"ahead_S{b}.oem")] == [f"NAME {b}"]
