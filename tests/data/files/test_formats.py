"""Parquet and epochs in tables, and the package `oem` as another reader and writer of messages."""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np
import pytest
import torch
from made_files import ORBIT, csv_of, orbit

from ahnn.data import Files
from ahnn.data.files import Covariance, Ephemeris, instant, read_oem, write_oem
from ahnn.data.reference import Reference
from ahnn.errors import UserError


def parquet(path, columns, units=None):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    table = pa.table(columns)
    for name, unit in (units or {}).items():
        field = pa.field(name, table.schema.field(name).type, metadata={"unit": unit})
        table = table.cast(table.schema.set(table.schema.get_field_index(name), field))
    pq.write_table(table, path)
    return str(path)


def test_parquet_says_the_same_as_csv(tmp_path):
    t, states = orbit()
    states[7, 2] = np.nan
    columns = {"id": ["a"] * 20 + ["b"] * 20, "t [s]": t}
    columns |= {name: states[:, k] for k, name in enumerate(ORBIT)}
    (tmp_path / "a.csv").write_text(csv_of(columns, zip(*columns.values(), strict=True)))
    one, other = (
        Files("mine", str(tmp_path / "a.csv")),
        Files("mine", parquet(tmp_path / "a.parquet", columns)),
    )
    assert one.space == other.space
    for a, b in zip(one.read()[:2], other.read()[:2], strict=True):
        assert torch.equal(a.nan_to_num(-1), b.nan_to_num(-1))


def test_parquet_has_units_in_its_fields_and_faults_with_their_place(tmp_path):
    columns = {"id": [1, 1, 2, 2], "t": [0, 1, 0, 1], "x": [1.0, 2, 3, 4], "vx": [1.0, 2, 3, 4]}
    path = parquet(tmp_path / "a.parquet", columns, {"t": "min", "x": "km", "vx": "m/s"})
    files = Files("mine", path)
    assert files.space.units.velocity == "km/s"
    assert files.read().times[0].tolist() == [0.0, 60.0]
    assert files.read().states[1, 1].tolist() == [4.0, 0.004]
    for change, expected in {
        "x": ([1.0, 2, np.inf, 4], "row 3, column x: expected a finite number up to 1e+150; received inf"),
        "t": ([0, 1, 0, 0], "row 4, column t: expected each time of 2 once"),
        "vx": ([[1.0]] * 4, "column vx: expected numbers, texts or times; received list<"),
    }.items():
        with pytest.raises(UserError) as caught:
            Files("mine", parquet(tmp_path / "b.parquet", columns | {change: expected[0]}))
        assert expected[1] in str(caught.value)
    (tmp_path / "c.parquet").write_bytes(b"PAR1 and nothing else")
    with pytest.raises(UserError, match=r"c.parquet: expected a Parquet file; received"):
        Files("mine", str(tmp_path / "c.parquet"))


@pytest.mark.parametrize("clock", ["", " [UTC]", " [TAI]"])
def test_epochs_are_times(tmp_path, clock):
    texts = ["2016-12-31T23:59:30", "2016-12-31 23:59:45.5", "2017-001T00:00:30Z"]
    rows = [(text, k, k) for k, text in enumerate(texts)]
    (tmp_path / "a.csv").write_text(csv_of([f"t{clock}", "x [km]", "vx [km/s]"], rows))
    files = Files("mine", str(tmp_path / "a.csv"))
    leap = 0 if "TAI" in clock else 1
    assert files.read().times.tolist() == [[0.0, 15.5, 60.0 + leap]]
    assert files.space.frame == f"from 2016-12-31T23:59:30.000 {'TAI' if leap == 0 else 'UTC'}"
    assert Reference.of(files.space.frame).epoch == files.epoch
    assert files.space.units.time == "s"


def test_epochs_of_parquet_and_of_several_files_in_minutes(tmp_path):
    utc = datetime.timezone.utc  # noqa: UP017
    for k in (0, 1):
        at = [datetime.datetime(2024, 1, 1, 1 - k, minute, tzinfo=utc) for minute in (0, 30)]
        columns = {"t": at, "x [m]": [1.0, 2.0], "vx [m/min]": [1.0, 1.0]}
        path = parquet(tmp_path / f"{k}.parquet", columns)
    files = Files("mine", [str(tmp_path / "0.parquet"), path])
    assert files.space.units.time == "min"
    assert files.read().times.tolist() == [[60.0, 90.0], [0.0, 30.0]]


def test_an_epoch_that_is_none_is_named(tmp_path):
    for bad in ("2024-02-30T00:00:00", "1.5", "tomorrow"):
        (tmp_path / "a.csv").write_text(f"t [UTC],x [km]\n2024-02-01T00:00:00,1\n{bad},2\n")
        with pytest.raises(UserError, match=r"a.csv, row 3, column t: expected (an epoch|a calendar date)"):
            Files("mine", str(tmp_path / "a.csv"))
    (tmp_path / "a.csv").write_text("t [EST],x [km]\n2024-02-01T00:00:00,1\n")
    with pytest.raises(UserError, match=r"column t: expected a time scale for the epochs: one of UTC, TAI"):
        Files("mine", str(tmp_path / "a.csv"))


@pytest.mark.filterwarnings("ignore:Testing an element's truth value")  # in the oem package, by Python 3.12
def test_the_oem_package_reads_what_is_written_and_is_read_itself(tmp_path):
    oem = pytest.importorskip("oem")
    start, (t, states) = instant("2024-03-01T12:00:00", utc=True), orbit()
    known = (Covariance(float(t[1]), np.diag([1.0, 2.0, 3.0, 1e-6, 2e-6, 3e-6])),)
    given = Ephemeris("2024-001A", "MINE", "EARTH", "EME2000", "UTC", start, t, states, known)
    for name in ("a.xml", "a.oem"):
        write_oem(tmp_path / name, [given], comments=["a remark", "another"])
        theirs = oem.OrbitEphemerisMessage.open(tmp_path / name)
        require_same(theirs, states)
        (segment,) = theirs.segments
        assert np.allclose(next(iter(segment.covariances)).matrix, known[0].matrix, rtol=1e-15, atol=0)
    theirs.save_as(tmp_path / "b.oem")
    theirs.save_as(tmp_path / "b.xml", file_format="xml")
    for name in ("b.oem", "b.xml"):
        (ours,) = read_oem(tmp_path / name)
        require_same(oem.OrbitEphemerisMessage.open(tmp_path / name), ours.states)
        assert ours.times.tolist() == t.tolist()


def require_same(message, states):
    """What the package has read is within 1e-9 km and km/s of some states."""
    (segment,) = message.segments
    found = np.array([[*state.position, *state.velocity] for state in segment.states])
    assert np.abs(found - states).max() <= 1e-9


def test_a_missing_library_is_one_message(tmp_path, monkeypatch):
    path = Path(parquet(tmp_path / "a.parquet", {"t": [0.0], "x": [1.0]}))
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(
        UserError,
        match=r"expected the package pyarrow; received none. Install it with pip install 'ahnn\[parquet\]'",
    ):
        Files("mine", str(path))
