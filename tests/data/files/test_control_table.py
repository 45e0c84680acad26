"""Controls over time in a file: held or interpolated, and refused by row and column."""

from __future__ import annotations

import pytest
import torch
from helpers import close

from ahnn.controls import ControlTable
from ahnn.data.files.control_table import read_controls
from ahnn.errors import UserError
from ahnn.types import Space, Units

DOUBLE = {"dtype": torch.float64}
TWO = Space("made", ("q", "p"), Units("s", "m", "m/s", "J"), controls=("u", "w"))
ONE = TWO._replace(controls=("u",))


def test_a_table_is_held_or_interpolated(tmp_path):
    (tmp_path / "c.csv").write_text("t [min],w,u,note\n0,1,10,0\n1,3,30,0\n")
    table = read_controls(tmp_path / "c.csv", TWO)
    assert table.times.tolist() == [0.0, 60.0]
    at = torch.tensor([0.0, 30.0, 60.0, 90.0], **DOUBLE)
    close(table.at(at), torch.tensor([[10.0, 1.0], [10.0, 1.0], [30.0, 3.0], [30.0, 3.0]], **DOUBLE), 0)
    (tmp_path / "c.yaml").write_text("controls: linear\nunits: {u: N}\n")
    expected = torch.tensor([[10.0, 1.0], [20.0, 2.0], [30.0, 3.0], [30.0, 3.0]], **DOUBLE)
    close(read_controls(tmp_path / "c.csv", TWO).at(at), expected, 1e-12)


def test_a_table_in_parquet_is_that_in_csv(tmp_path):
    arrow = pytest.importorskip("pyarrow", reason="the extra `parquet` is needed")
    columns = arrow.table({"time": [0.0, 2.5], "w": [1.0, 3.0], "u": [10.0, 30.0]})
    pytest.importorskip("pyarrow.parquet").write_table(columns, tmp_path / "c.parquet")
    table = read_controls(tmp_path / "c.parquet", TWO)
    assert table.times.tolist() == [0.0, 2.5]
    assert table.values.tolist() == [[10.0, 1.0], [30.0, 3.0]]


@pytest.mark.parametrize("span", [1e-3, 1.0, 1e3])
def test_times_that_differ_by_rounding_are_the_same(span):
    """By a part of the span in a thousand million, before a change and before the first time."""
    table = ControlTable(span * torch.tensor([0.0, 0.5, 1.0], **DOUBLE), torch.arange(3.0, **DOUBLE)[:, None])
    for off, expected in ((5e-10, [0.0, 1.0, 2.0]), (2e-9, [0.0, 0.0, 1.0])):
        at = span * torch.tensor([0.0, 0.5 - off, 1.0 - off], **DOUBLE)
        assert table.at(at)[:, 0].tolist() == expected
    assert table.at(span * torch.tensor([-5e-10, 1.0], **DOUBLE))[:, 0].tolist() == [0.0, 2.0]
    with pytest.raises(
        UserError, match=r"expected values at the start, time -2e-.*; received the first at 0"
    ):
        table.at(span * torch.tensor([-2e-9, 1.0], **DOUBLE))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t,v\n0,1\n", "row 1: expected the control columns u; received t, v"),
        ("s,u\n0,1\n", "expected one column named t or time"),
        ("t,time,u\n0,0,1\n", "expected one column named t or time"),
        ("t,u\n0,1\n0,2\n3,1\n", "row 3, column t: expected increasing times; received 0"),
        ("t,u\n0,1\n2,3\n1,2\n", "row 4, column t: expected increasing times; received 1"),
        ("t,u\n0,1\n1,\n", "row 3, column u: expected a number in each row; received none. Repeat"),
        ("t,u\n,1\n", "row 2, column t: expected a number in each row; received none"),
        ("t [km],u\n0,1\n", "expected a unit compatible with s; received km"),
        ("t,u\n", "expected a row for each change of a control; received only a header"),
    ],
)
def test_tables_that_are_no_controls_are_refused_by_row_and_column(text, said, tmp_path):
    (tmp_path / "c.csv").write_text(text)
    with pytest.raises(UserError) as error:
        read_controls(tmp_path / "c.csv", ONE)
    assert said in str(error.value)


def test_what_is_no_table_is_refused(tmp_path):
    with pytest.raises(UserError, match=r"controls: .*: No such file"):
        read_controls(tmp_path / "none.csv", ONE)
    with pytest.raises(UserError, match=r"controls: .*: not a regular file"):
        read_controls(tmp_path, ONE)
    (tmp_path / "a.oem").write_text("CCSDS_OEM_VERS = 2.0\n")
    with pytest.raises(UserError, match="expected a table with time and u; received oem"):
        read_controls(tmp_path / "a.oem", ONE)


@pytest.mark.parametrize("said", ["columns: {time: t}\n", "frame: EME2000\n"])
def test_a_sidecar_of_controls_says_neither_columns_nor_a_frame(tmp_path, said):
    (tmp_path / "c.csv").write_text("t,u\n0,1\n")
    (tmp_path / "c.yaml").write_text(said)
    with pytest.raises(UserError, match="expected only units and controls in the sidecar of a control file"):
        read_controls(tmp_path / "c.csv", ONE)


def test_other_columns_are_named_and_not_used(tmp_path, caplog):
    (tmp_path / "c.csv").write_text("t,u,note,more\n0,1,2,3\n")
    assert read_controls(tmp_path / "c.csv", ONE).values.tolist() == [[1.0]]
    assert "not used, since they are not controls: note, more" in caplog.text
