"""`assimilate start=fit`: the first measurements are fitted, the others are filtered."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
import torch
from entry import call
from test_assimilate import ORBIT, RUN

COMMAND = ["pretrained=molniya_mechanical", "plugins.ukf.process_noise=[1e-5,1e-7]", "measurement.sd=0.05"]
COMMAND += ["measurements=fixes.csv", "start=fit", "output=out.csv"]


def write(states, step, seed=0, name="fixes.csv"):
    noise = torch.randn(len(states), 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    rows = [
        ",".join(map(repr, [k * step, *row])) for k, row in enumerate((states[:, :3] + 0.05 * noise).tolist())
    ]
    Path(name).write_text("\n".join(["time,x,y,z", *rows]) + "\n")


def rows():
    return list(csv.DictReader(Path("out.csv").read_text().splitlines()))


def assimilate(*arguments):
    return call("ahnn.assimilate", *COMMAND, *arguments)


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(ORBIT, 15.0)


def test_the_first_lines_are_fitted_and_the_others_filtered(caplog):
    assert assimilate("fitted=15", "state=a.state") == 0
    assert "start: fitted to the first 15 measurements, up to line 16" in caplog.text
    assert "41 lines: 15 fitted, 26 taken" in caplog.text
    found = rows()
    assert [int(row["line"]) for row in found] == [*range(17, 43)]
    off = torch.tensor([float(found[0][n]) for n in ("x", "y", "z")]) - ORBIT[15, :3]
    assert float(off.norm()) < 0.2
    before = Path("out.csv").read_bytes()
    assert assimilate("fitted=15", "state=a.state") == 0
    assert Path("out.csv").read_bytes() == before


def test_errors_of_fitted_starts_have_their_covariance():
    """Over draws of the noise NEES is chi-square of six: its mean of 8 is 6 to within 1.2."""
    from ahnn.assimilation import StreamSensor
    from ahnn.assimilation.stream_clock import StreamClock
    from ahnn.jobs.fitted_start import fitted_start
    from ahnn.measurements import Position

    orbit, found = RUN.rollout(ORBIT[0], 12, 60.0)[0], []
    sensors = {"position": StreamSensor.of(Position(), 0.05, RUN.space)}
    for seed in range(8):
        write(orbit, 60.0, seed)
        start, line = fitted_start(RUN, sensors, "fixes.csv", StreamClock("s", None, "UTC"), None)
        assert line == 14
        off = start.states[0] - orbit[-1]
        found.append(float(off @ torch.linalg.solve(start.covariances[0], off)))
    assert 3 < sum(found) / 8 < 10


def test_dates_of_the_measurements_define_time_zero_where_the_model_has_none():
    """The rows are those of the same measurements with times in seconds, with their epochs."""
    assert assimilate() == 0
    plain = rows()
    head, *lines = Path("fixes.csv").read_text().splitlines()
    dated = [
        f"2024-03-01T05:{k * 15 // 60:02d}:{k * 15 % 60:02d},{line.split(',', 1)[1]}"
        for k, line in enumerate(lines)
    ]
    Path("fixes.csv").write_text("\n".join(["# cell 1", head, *dated]) + "\n")
    assert assimilate("output=dated.csv") == 0
    found = list(csv.DictReader(Path("dated.csv").read_text().splitlines()))
    assert found[0]["epoch"][:19] == "2024-03-01T05:05:00"
    for one, other in zip(found, plain, strict=True):
        assert float(one["x"]) == pytest.approx(float(other["x"]), abs=1e-3)


def test_outliers_do_not_spoil_the_fit():
    lines = Path("fixes.csv").read_text().splitlines()
    time, x, *rest = lines[4].split(",")
    lines[4] = ",".join([time, repr(float(x) + 500.0), *rest])
    Path("fixes.csv").write_text("\n".join(lines) + "\n")
    assert assimilate() == 0
    off = torch.tensor([float(rows()[0][n]) for n in ("x", "y", "z")]) - ORBIT[20, :3]
    assert float(off.norm()) < 0.2


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["fitted=1"], "start: expected 6 values or more, at two times or more; received 1 measure"),
        (["fitted=41"], "received 41 of 41 fitted. The start uses all of them"),
        (["measurements=-"], "start: expected measurements=FILE with start=fit"),
        (["start_sd=[1,1]"], "start_sd: expected none with start=fit"),
        (["time=3"], "time: expected none with start=fit"),
        (["start=[0,0,0,0,0,0]", "fitted=3"], "fitted: expected start=fit with fitted=3"),
        (["objects=x"], "objects: expected none with start=fit"),
        (
            ["measurement.sd=1e-4"],
            "expected a state that fits the first 20 measurements; received none",
        ),
    ],
)
def test_what_does_not_go_together_is_refused(words, said, capsys):
    assert assimilate(*words) in (2, 3)
    assert said in capsys.readouterr().err
    assert not Path("out.csv").exists()
