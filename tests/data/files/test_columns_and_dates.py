"""Columns of tables by their names, rows without a name, quotes, and dates in many notations."""

from __future__ import annotations

import pytest
from made_files import ORBIT, csv_of, refused, said

from ahnn.data.files import Files, instant
from ahnn.data.files.columns import rates_of
from ahnn.data.files.table import Fault


def test_columns_that_nothing_is_read_of_are_said(tmp_path):
    (tmp_path / "a.csv").write_text("# by hand\nt,x,sd_x\n0,1,9\n1,2,9\n")
    found, notes = said(tmp_path / "a.csv")
    assert (found.positions, found.rates) == (("x",), ())
    assert [(one.name, one.role) for one in found.columns] == [
        ("t", "time"),
        ("x", "position"),
        ("sd_x", "not used"),
    ]
    assert [one.what for one in notes] == [
        "1 line starting with # skipped",
        "sd_x: used for a start, but not for training",
    ]
    remedy = "For training, set one standard deviation for all samples: sensor=recorded data.noise=..."
    assert notes[1].remedy == remedy
    (tmp_path / "a.yaml").write_text("columns: {time: t, positions: x}")
    (tmp_path / "a.csv").write_text("t,x,note\n0,1,9\n1,2,9\n")
    assert [one.what for one in said(tmp_path / "a.csv")[1]] == [
        "not used, since the sidecar does not name them: note"
    ]


def test_an_index_of_pandas_and_other_metadata_are_no_columns(tmp_path):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    table = pa.table({"t": [0.0, 1.0], "x": [1.0, 2.0], "__index_level_0__": [5, 6]})
    table = table.cast(table.schema.set(1, pa.field("x", pa.float64(), metadata={"units": "km"})))
    pq.write_table(table, tmp_path / "a")
    found, notes = said(tmp_path / "a")
    assert found.positions == ("x",)
    assert [one.what for one in notes] == [
        "not used: the pandas index __index_level_0__",
        "not used: metadata units",
    ]


def test_rows_without_the_name_of_their_trajectory_are_faults(tmp_path):
    (tmp_path / "a.csv").write_text("id,t,x\na,0,1\n,1,2\na,2,3\nnan,0,1\n")
    found, notes = said(tmp_path / "a.csv")
    assert [one.place.row for one in notes] == [3, 5]
    assert [track.name for track in found.tracks] == ["a"]
    assert "row 3, column id: expected the name of a trajectory; received none" in refused(tmp_path / "a.csv")


def test_quoted_cells_are_read_and_an_open_quote_is_a_fault(tmp_path):
    text = 'id;"t [s]"; "x, east [m]" ;"v [m/s]"\n"a"; "0"; "1.5";2\n'
    (tmp_path / "a.csv").write_text(text)
    (tmp_path / "a.yaml").write_text('columns: {time: t, id: id, positions: "x, east", velocities: v}')
    assert said(tmp_path / "a.csv")[0].tracks[0].values.tolist() == [[1.5, 2.0]]
    (tmp_path / "a.csv").write_text(text.replace('"1.5"', '"1.5'))
    assert "row 2: expected quoted cells that end on the same line" in refused(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_text(f't,x\n0,"{"1" * 200000}"\n')
    assert "row 2: expected quoted cells" in refused(tmp_path / "b.csv")


SAME = [
    "2026-01-01T12:00:00+02:00",
    "2026-01-01 12:00:00 +0200",
    "2026-01-01T04:30:00-05:30",
    "2026-01-01T10:00Z",
    "2026/01/01 10:00:00",
]


@pytest.mark.parametrize("text", SAME)
def test_epochs_of_one_instant(text):
    assert instant(text, utc=True) == instant("2026-01-01T10:00:00", utc=True)


def test_a_leap_second_of_another_time_zone_and_offsets_of_clocks_that_have_none():
    assert instant("2017-01-01T01:59:60+02:00", utc=True) == instant("2016-12-31T23:59:60", utc=True)
    with pytest.raises(ValueError, match="without an offset"):
        instant("2026-01-01T12:00:00+02:00", utc=False)
    with pytest.raises(ValueError, match="a UTC offset"):
        instant("2026-01-01T12:00:00+77:00", utc=True)


@pytest.mark.parametrize(
    "text",
    ["01/03/2024 12:00:00", "1 Mar 2024 12:00", "Mar 1, 2024", "12:00:00", "2024.03.01", "20240301T120000"],
)
def test_a_date_in_another_notation_is_called_one(tmp_path, text):
    rows = "".join(f'"{text}",{k}\n' for k in range(3))
    (tmp_path / "a.csv").write_text(f"t,x [m]\n{rows}")
    message = refused(tmp_path / "a.csv")
    assert "row 2, column t: expected an epoch such as 2024-03-01T12:00:00.125" in message
    assert f"received {text!r}, in another notation" in message


MOVING = {
    "T,X,Y,Z,VX,VY,VZ": "X Y Z|VX VY VZ",
    "t,theta,theta_dot": "theta|theta_dot",
    "t,x,y,xdot,ydot": "x y|xdot ydot",
    "t,q,dq": "q|dq",
    "t,x,dx": "x|dx",
    "t,x,dx/dt": "x|dx/dt",
    "t,theta1,theta2,omega1,omega2": "theta1 theta2|omega1 omega2",
    "t,Position_X,Velocity_X": "Position_X|Velocity_X",
    "t,rx,ry,vx,vy": "rx ry|vx vy",
    "t,x,v": "x|v",
    "t,X,x,vx,VX": "X x|VX vx",
    "t,angle,angular_velocity": "angle|angular_velocity",
    "t,qx,qy,px,py": "qx qy|px py",
    "t,x,\u1e8b": "x|\u1e8b",
}


@pytest.mark.parametrize("header", MOVING)
def test_velocities_are_known_by_their_usual_names(tmp_path, header):
    names = header.split(",")
    (tmp_path / "a.csv").write_text(f"{header}\n{','.join('1' * len(names))}\n")
    found = said(tmp_path / "a.csv")[0]
    assert f"{' '.join(found.positions)}|{' '.join(found.rates)}" == MOVING[header]
    assert found.momenta == ("px" in names)


LONELY = ("t,vx,vy", "t,v", "t,omega", "t,y,x_dot", "t,x,vx,ax", "t,x,x_dot,x_dot_dot", "t,ax,ay", "t,dq")
OTHERS = ("t,x,speed", "t,x,x_sd", "t,index,x", "t,x,energy", "t,momentum", "t,x,VY")


@pytest.mark.parametrize("header", [*LONELY, *OTHERS])
def test_a_name_that_is_none_of_a_position_is_no_position_in_silence(tmp_path, header):
    (tmp_path / "a.csv").write_text(f"{header}\n{','.join('1' * len(header.split(',')))}\n")
    assert "sidecar" in refused(tmp_path / "a.csv")


def test_a_column_has_one_role_in_a_sidecar(tmp_path):
    (tmp_path / "a.csv").write_text("t,x\n0,1\n")
    (tmp_path / "a.yml").write_text("columns: {time: t, positions: [x, x]}")
    assert "column x: expected one role in the sidecar" in refused(tmp_path / "a.csv")


def test_centres_other_than_the_earth_have_no_frames_of_it(tmp_path):
    pytest.importorskip("erfa")
    rows = [("2024-01-01T00:00:00", 7000, 0, 0, 0, 7.5, 0)]
    (tmp_path / "a.csv").write_text(csv_of(["t [UTC]", *ORBIT], rows))
    (tmp_path / "a.yaml").write_text("frame: TEME, Mars")
    with pytest.raises(Fault, match="expected the Earth as the centre of TEME; received MARS"):
        said(tmp_path / "a.csv", "GCRF")


@pytest.mark.parametrize(
    ("position", "velocities", "momenta"),
    [
        (
            "x",
            "vx velx velocityx xvel xvelocity xdot x' dx dxdt dx/dt v vel velocity",
            "px xmomentum p momentum",
        ),
        ("q2", "vq2 q2dot v2 vel2 velocity2 w2 omega2 angularvelocity2", "pq2 p2 momentum2"),
        ("theta", "thetadot v omega w", "ptheta momtheta p"),
        ("rx", "vrx vx velx velocityx rxdot", "prx px momx momentumx"),
        ("positiony", "vy vely velocityy", "py momy momentumy"),
    ],
)
def test_rates_have_the_names_of_their_positions(position, velocities, momenta):
    known = rates_of(position)
    assert set(velocities.split()) <= known["velocities"]
    assert set(momenta.split()) <= known["momenta"]
    for kind, names in known.items():
        assert not names & {"xdot", "yvel", "xvel", "2vel", "xmom", "ymomentum"} or position == "x", kind


def test_a_column_epoch_is_the_time_of_a_table_without_another(tmp_path):
    rows = "{0},1,2\n{1},3,4\n{2},5,6\n"
    dates = [f"2024-03-01T12:00:0{k}.5" for k in range(3)]
    for head, cells in (("Epoch", dates), ("epoch [s]", [0, 1, 2]), ("t [s]", [0, 1, 2])):
        (tmp_path / "a.csv").write_text(f"{head},x [m],y [m]\n{rows.format(*cells)}")
        found = Files("mine", str(tmp_path / "a.csv"))
        assert found.trajectories.times.tolist() == [[0.0, 1.0, 2.0]]
        assert found.space.components[:2] == ("x", "y")
    (tmp_path / "a.csv").write_text("t [s],epoch [m],x [m]\n" + rows.format(0, 1, 2))
    assert Files("mine", str(tmp_path / "a.csv")).space.components[:2] == ("epoch", "x")
