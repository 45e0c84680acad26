"""Faults of files: each is found with its file, row and column, and leads to one message."""

from __future__ import annotations

import random

import pytest
from made_files import csv_of, said

from ahnn.data import Files
from ahnn.data.files.table import Fault
from ahnn.errors import UserError

GOOD = "id,t [s],x [km],vx [km/s]\na,0,1,2\na,1,2,3\nb,0,1,2\nb,1,2,3\n"
FAULTS = {
    "no line": ("", "data.csv: expected a header and a row for each sample; received no line"),
    "only a header": (GOOD[:26], "row 1: expected a row for each sample; received only a header"),
    "no header": ("0,1,2\n1,2,3\n", "data.csv, row 1: expected column names"),
    "text": (GOOD.replace("a,1,2,3", "a,1,two,3"), "row 3, column x: expected a number; received 'two'"),
    "underscore": (GOOD.replace("a,1,2,3", "a,1,2_0,3"), "row 3, column x: expected a number"),
    "infinite": (GOOD.replace("b,0,1,2", "b,0,1,-inf"), "row 4, column vx: expected a finite number"),
    "short row": (GOOD.replace("b,0,1,2", "b,0,1"), "row 4: expected 4 cells, as in the header; received 3"),
    "long row": (GOOD.replace("b,0,1,2", "b,0,1,2,9"), "row 4: expected 4 cells"),
    "no time": (GOOD.replace("t [s]", "u [s]"), "row 1: expected one column named t, time or epoch"),
    "no unit of time": (
        GOOD.replace("t [s]", "t"),
        "column t: expected a unit, since other columns have one; received none. Write t [s] or t_s",
    ),
    "two times": (GOOD.replace("id", "time [s]"), "expected one column named t, time or epoch"),
    "time missing": (GOOD.replace("a,1,2,3", "a,,2,3"), "row 3, column t: expected a time; received none"),
    "duplicate": (
        GOOD.replace("b,1,2,3", "b,0,2,3"),
        "row 5, column t: expected each time of b once; received 0.0, which duplicates row 4. Give each",
    ),
    "repeated row": (
        GOOD.replace("b,1,2,3", "b,0,1,2"),
        "row 5, column t: expected each time of b once; received 0.0, which duplicates row 4. Remove the",
    ),
    "disorder": (
        GOOD.replace("a,1,2,3", "a,-1,2,3"),
        "row 3, column t: expected a time of a after 0.0 in row 2; received -1.0",
    ),
    "twice": (
        GOOD.replace("id", "x"),
        "row 1, column x: expected a different name for each column; received it twice",
    ),
    "unknown unit": (GOOD.replace("x [km]", "x [miles]"), "column x: expected a unit, a product of powers"),
    "two names of a trajectory": (
        GOOD.replace("x [km]", "trajectory"),
        "row 1: expected one column named t, time or epoch, and at most one named id or trajectory",
    ),
    "no length": (GOOD.replace("x [km]", "x [kg]"), "column x: expected a length, an angle or [1]"),
    "no time unit": (GOOD.replace("t [s]", "t [m]"), "column t: expected a time or [1]; received 'm'"),
    "speed": (GOOD.replace("[km/s]", "[km]"), "column vx: expected the unit of a velocity (km per time)"),
    "unit missing": (
        GOOD.replace("x [km]", "x", 1),
        "column x: expected a unit, since other columns have one",
    ),
    "half": (
        GOOD.replace("id", "y [km]").replace("a", "0").replace("b", "1"),
        "column y: expected velocities for all positions, like vx",
    ),
    "velocity twice": (
        "t,x,vx,v_x\n0,1,2,3\n",
        "row 1: expected a velocity or a momentum for each position; received vx, v_x",
    ),
    "both": (
        "t,x,vx,px\n0,1,2,3\n",
        "row 1: expected a velocity or a momentum for each position; received vx, px",
    ),
    "momentum of no mass": (
        GOOD.replace("vx [km/s]", "px [kg km/s]"),
        "system.mass: expected the mass in p = m dq/dt for the momenta px",
    ),
    "all missing": (
        GOOD.replace("b,0,1,2", "b,0,,2").replace("b,1,2,3", "b,1,,3"),
        "row 4: expected a trajectory b",
    ),
}


def message_of(folder, text, sidecar=None, name="data.csv", **options):
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    if sidecar is not None:
        (folder / name).with_suffix(".yaml").write_text(sidecar)
    with pytest.raises(UserError) as caught:
        Files("mine", str(folder / name), **options)
    return str(caught.value)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_with_its_place(tmp_path, fault):
    text, expected = FAULTS[fault]
    assert text != GOOD
    assert expected in message_of(tmp_path, text)


@pytest.mark.parametrize(
    ("sidecar", "expected"),
    [
        ("a: [", "data.yaml: expected YAML"),
        ("unit: {x: km}", "objects, mass; received 'unit'; did you mean 'units'?"),
        ("measurements: od.csv", "If it is not the sidecar of the data file of the same name, rename one of"),
        ("units: {z: km}", "expected a column 'z' (units)"),
        ("units: {x: m}", "column x: expected [m], as in the sidecar; received [km]. State it once"),
        ("mass: 2", "data.yaml: expected mass: canonical; received 2. Give a number as system.mass"),
        ("mass: '2'", "data.yaml: expected mass: canonical; received '2'. Give a number as system.mass"),
        ("mass: canonical", "expected momenta, since the sidecar states mass: canonical; received vx"),
        ("columns: {time: s}", "expected a column 's' (time)"),
        ("columns: {times: t}", "expected one of the roles time, id, positions, velocities, momenta"),
        ("columns: {time: [t, x]}", "data.yaml: expected one column (time); received time: ['t', 'x']"),
        ("columns: {positions: x}", "data.yaml: expected columns: time, positions, and equally many"),
        ("columns: {time: t, positions: [x, id], velocities: vx}", "equally many velocities or momenta"),
        ("columns: {time: t, velocities: vx}", "if it names any of them; received time: t, velocities: vx"),
    ],
)
def test_a_fault_of_a_sidecar(tmp_path, sidecar, expected):
    assert expected in message_of(tmp_path, GOOD, sidecar)


def test_momenta_of_several_files_have_one_meaning(tmp_path):
    paths = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for k, path in enumerate(paths):
        path.write_text("id,t,q,p\n" + "".join(f"{k},{n},{n},1\n" for n in range(5)))
    paths[0].with_suffix(".yaml").write_text(
        "columns: {id: id, time: t, positions: q, momenta: p}\nmass: canonical\n"
    )
    paths[1].with_suffix(".yaml").write_text("columns: {id: id, time: t, positions: q, momenta: p}\n")
    expected = r"b.csv: expected momenta canonical, as in .*a.csv; received mass times velocity"
    with pytest.raises(UserError, match=expected):
        Files("mine", [str(path) for path in paths])
    paths[1].with_suffix(".yaml").write_text(
        "columns: {id: id, time: t, positions: q, momenta: p}\nmass: canonical\n"
    )
    assert not Files("mine", [str(path) for path in paths]).space.mechanical


def test_a_file_that_is_none(tmp_path):
    with pytest.raises(UserError, match=r"system.path: expected a file; received .*none.csv: No such file"):
        Files("mine", str(tmp_path / "none.csv"))
    with pytest.raises(UserError, match="Is a directory"):
        Files("mine", str(tmp_path))
    for nothing in (None, [], ""):
        with pytest.raises(UserError, match=r"system.path: .*received none. Set system.path=FILE"):
            Files("mine", nothing)
    good = tmp_path / "good.csv"
    good.write_text(GOOD)
    with pytest.raises(UserError, match=r"expected different files; received .*good.csv twice"):
        Files("mine", [str(good), f"{tmp_path}/../{tmp_path.name}/good.csv"])
    assert "row 2: expected UTF-8 text" in message_of(tmp_path, b"t,x,vx\n0,\xff,1\n")
    assert "row 3: expected UTF-8 text" in message_of(tmp_path, b"t,x,vx\n0,1,1\n\xff,1,1\n")


def test_a_gap_that_separates_two_trajectories(tmp_path):
    text = "t,q,v\n0,0,0\n1,0,0\n2,0,0\n1000,0,0\n"
    assert "row 5: expected gaps with at most 20 missing samples" in message_of(tmp_path, text)


def test_files_that_disagree(tmp_path):
    (tmp_path / "a.csv").write_text("t [s],x [km],vx [km/s]\n0,1,2\n1,2,3\n")
    for text, expected in {
        "t [s],x [m],vx [m/s]\n0,1,2\n": "b.csv: expected units s, km, km/s, km²/s², as in",
        "t [s],y [km],vy [km/s]\n0,1,2\n": "b.csv: expected positions x, as in",
        "t [s],x [km]\n0,1\n": "b.csv: expected rates vx, as in",
    }.items():
        (tmp_path / "b.csv").write_text(text)
        with pytest.raises(UserError) as caught:
            Files("mine", [str(tmp_path / "a.csv"), str(tmp_path / "b.csv")])
        assert expected in str(caught.value)


def test_a_hundred_faults_in_random_cells_are_found_where_they_are(tmp_path):
    draw = random.Random(0)
    header = ["id", "t [s]", "x [km]", "y [km]", "vx [km/s]", "vy [km/s]"]
    for _ in range(100):
        rows = [
            [name, str(k), *(f"{draw.random():.6f}" for _ in range(4))] for name in "ab" for k in range(30)
        ]
        row, column = draw.randrange(1, 60), draw.randrange(1, 6)
        row += row == 30  # the first of a trajectory has no time before it
        kind = draw.choice(["text", "infinite", "short", *(["duplicate", "disorder"] if column == 1 else [])])
        if kind == "short":
            rows[row].pop()
        else:
            bad = {"text": "1.2.3", "infinite": "inf", "duplicate": rows[row - 1][1], "disorder": "-5"}[kind]
            rows[row][column] = bad
        said = message_of(tmp_path, "\n".join(",".join(cells) for cells in (header, *rows)))
        place = "" if kind == "short" else f", column {header[column].split()[0]}"
        assert f"data.csv, row {row + 2}{place}: expected" in said


def test_decimal_commas_are_one_fault(tmp_path):
    path = tmp_path / "data.csv"
    path.write_text("t;x\n0,0;1,5\n1,0;-2,5e-3\n")
    with pytest.raises(Fault) as caught:
        said(path)
    expected = (
        "row 2, column t: expected a number with a decimal point; received '0,0', with a decimal comma. "
    )
    assert str(caught.value).endswith(f"{expected}Replace each decimal comma in the file by a point")


@pytest.mark.parametrize("binary", [False, True], ids=["text", "parquet"])
def test_numbers_count_up_to_those_whose_squares_are_infinite(tmp_path, binary):
    path, values = tmp_path / "a", [1e150, -1e150, 1.0000000000000002e150, -1.0000000000000002e150]
    if binary:
        pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
        pq.write_table(pa.table({"t": [0.0, 1.0, 2.0, 3.0], "x": values}), path)
    else:
        path.write_text(csv_of(["t", "x"], enumerate(values)))
    found, notes = said(path)
    assert [one.place.row for one in notes if isinstance(one, Fault)] == ([3, 4] if binary else [4, 5])
    assert all("expected a finite number up to 1e+150" in str(one) for one in notes if isinstance(one, Fault))
    assert found.tracks[0].values[:2].tolist() == [[1e150], [-1e150]]


def test_times_in_the_wrong_order_are_written_as_in_the_file(tmp_path):
    rows = ["2024-03-01T10:00:00,1", "2024-03-01T12:00:00.25,2", "2024-03-01T11:00:00.5,3"]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["time,q", *rows]) + "\n")
    with pytest.raises(UserError) as caught:
        Files("a", str(path))
    said = "a time after 2024-03-01T12:00:00.250 in row 3; received 2024-03-01T11:00:00.500. Sort the rows"
    assert said in str(caught.value)
