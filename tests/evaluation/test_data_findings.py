"""The table of findings: the largest of similar ones come first, and names of files stay on one line."""

from __future__ import annotations

import io
import math
import re

from rich.console import Console

from ahnn.data.doctor import examine
from ahnn.data.files.reading import FileReading
from ahnn.evaluation.data_findings import checkup


def lines_of(folder, name, kept):
    """The lines of the table for a swing with some of 400 samples, one a minute."""
    rows = "".join(f"{60 * k},{math.sin(k / 30)!r},{math.cos(k / 30) / 1800!r}\n" for k in kept)
    (folder / name).write_text(f"t [s],x [m],vx [m/s]\n{rows}")
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(checkup(examine([folder / name], FileReading())))
    return console.export_text().splitlines()


def test_the_longest_gaps_come_first_with_their_duration(tmp_path):
    single, long = {20 * k + 3 for k in range(15)}, {*range(310, 370)}
    kept = [k for k in range(400) if k not in single | long]
    lines = [line for line in lines_of(tmp_path, "a.csv", kept) if "a gap of" in line or "more like" in line]
    assert "a gap of 61.0 min: 60" in lines[0]
    assert all("a gap of 2.0 min: 1 " in line for line in lines[1:5])
    assert "11 more like these" in lines[5]
    assert sum("Nothing to do" in line for line in lines) == 1
    assert all(line.rstrip().endswith("as above") for line in lines[1:5])


def test_the_rows_of_the_rest_are_named(tmp_path):
    gone = {20 * k + 3 for k in range(8)}
    text = " ".join(" ".join(lines_of(tmp_path, "a.csv", [k for k in range(400) if k not in gone])).split())
    shown = [int(row) for row in re.findall(r"warning a.csv (\d+) t ", text)]
    rest = [int(row) for row in re.search(r"3 more like these, in rows ([\d, ]+)", text)[1].split(",")]
    assert len(shown) == 5
    assert sorted(shown + rest) == [20 * k + 5 - k for k in range(8)]


def test_the_name_of_a_file_is_on_one_line(tmp_path):
    kept = [k for k in range(60) if k != 30]
    assert any("sight4_long.csv " in line for line in lines_of(tmp_path, "sight4_long.csv", kept)[:-2])
    long = "recording_of_the_tracker_2026.csv"
    assert any("recording...2026.csv " in line for line in lines_of(tmp_path, long, kept)[:-2])
