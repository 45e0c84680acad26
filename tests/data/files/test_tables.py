"""Files of one's own: what is read, in which units, and how gaps, ids and cuts make trajectories."""

from __future__ import annotations

import logging

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from made_files import csv_of, said

from ahnn.data import Files
from ahnn.data.windows import segments
from ahnn.statistics import sampling_interval
from ahnn.types import Units


def written(folder, text, sidecar=None, name="data.csv"):
    path = folder / name
    path.write_text(text)
    if sidecar is not None:
        path.with_suffix(".yaml").write_text(sidecar)
    return str(path)


def read(folder, text, sidecar=None, **options):
    return Files("mine", written(folder, text, sidecar), **options)


def table(header, rows):
    return "\n".join([header, *(",".join(map(repr, row)) for row in rows)]) + "\n"


def test_columns_are_told_by_their_names_and_brought_to_common_units(tmp_path):
    text = (
        "vy [m/s],t [min],id,x [km],y [m],vx [km/s]\n500,1,a,7,8000,0.25\n,2,a,7.5,,0.5\n250,3,a,8,9000,1\n"
    )
    files = read(tmp_path, text)
    assert files.space.components == ("x", "y", "px", "py")
    assert files.space.units == Units("s", "km", "km/s", "km²/s²")
    states, times, *_ = files.read()
    assert times.tolist() == [[60.0, 120.0, 180.0]]
    expected = torch.tensor([[7, 8, 0.25, 0.5], [8, 9, 1, 0.25]], dtype=torch.float64)
    assert torch.equal(states[0, ::2], expected)
    assert states[0, 1].isnan().tolist() == [False, True, False, True]
    assert files.read().present.tolist() == [[True, False, True]]
    assert not files.positions_only


def test_momenta_are_mass_times_velocity(tmp_path):
    heavy = read(tmp_path, "t [s],x [km],vx [m/s]\n0,1,2000\n1,2,3000\n", mass=4.0)
    assert heavy.space.inertia == 4.0
    assert heavy.space.units == Units("s", "km", "km/s", "kg km²/s²")
    assert heavy.read().states[0, :, 1].tolist() == [8.0, 12.0]
    given = read(tmp_path, "t [s],x [km],px [kg m/s]\n0,1,8000\n1,2,12000\n", mass=4.0)
    assert torch.equal(given.read().states, heavy.read().states)
    turning = read(tmp_path, "t [s],q [deg],v [deg/s]\n0,180,90\n1,270,90\n", mass=2.0)
    assert turning.space.units == Units("s", "rad", "rad/s", "J")
    assert turning.read().states[0, 0].tolist() == pytest.approx([np.pi, np.pi], rel=1e-15)
    spun = read(tmp_path, "t [s],q [deg],p [kg m^2/s]\n0,180,3\n1,270,3\n", mass=2.0)
    assert spun.read().states[0, 0].tolist() == pytest.approx([np.pi, 3.0], rel=1e-15)
    bare = read(tmp_path, "t;q1;q2;p1;p2\n0;1;2;3;4\n1;2;3;4;5\n", mass=1.0)
    assert bare.space.units == Units()
    assert bare.space.components == ("q1", "q2", "p1", "p2")


def test_a_sidecar_names_columns_units_and_frame(tmp_path):
    text = "# measured in May\nsat,epoch,a,b,note\n7,0,1,2,fine\n7,60,2,1,bad\n"
    columns = "columns: {time: epoch, id: sat, positions: a, velocities: b}"
    sidecar = f"units: {{epoch: s, a: km, b: m/s}}\n{columns}\nframe: GCRF\n"
    files = read(tmp_path, text, sidecar)
    assert files.space.frame == "GCRF"
    assert files.read().states[0, 0].tolist() == [1.0, 0.002]
    changed = read(tmp_path, text, sidecar.replace("m/s", "km/s"))
    assert changed.recipe() != files.recipe()


def test_columns_that_a_sidecar_without_positions_does_not_name_have_the_roles_of_their_names(tmp_path):
    text = (
        "sat,zeit [s],x [km],vx [m/s],F [N],sd_x [km]\n7,0,1,2,0,1\n7,60,2,1,1,1\n8,0,3,3,1,1\n8,60,3,3,1,1\n"
    )
    files = read(tmp_path, text, "columns: {time: zeit, id: sat, controls: F}")
    assert files.names == ("7", "8")
    assert files.read().states[:, 0].tolist() == [[1.0, 0.002], [3.0, 0.003]]
    assert files.space.controls == ("F",)
    one = read(tmp_path, text.replace("zeit", "t").replace("F [N]", "u [N]"), "columns: {id: sat}")
    assert (one.names, one.space.controls) == (("7", "8"), ("u",))


def test_positions_alone_have_unknown_momenta(tmp_path):
    files = read(tmp_path, "t [s],x [km],y [km]\n0,1,2\n1,2,3\n")
    assert files.positions_only
    assert files.read().states[..., 2:].isnan().all()
    assert files.read().states[0, :, :2].tolist() == [[1.0, 2.0], [2.0, 3.0]]
    assert files.steps() == 1


def test_rows_of_several_ids_may_be_mixed(tmp_path):
    text = "id,t,q,v\nb,0,1,1\na,0,2,2\nb,1,3,3\na,0.5,4,4\nb,2,5,5\n"
    states, times, *_ = read(tmp_path, text).read()
    assert times[0].tolist() == [0.0, 1.0, 2.0]
    assert times[1, :2].tolist() == [0.0, 0.5]
    assert times[1, 2].isnan()
    assert states[0, :, 0].tolist() == [1.0, 3.0, 5.0]


def test_several_files_are_trajectories_side_by_side(tmp_path):
    paths = [
        written(tmp_path, f"t [s],x [km],vx [km/s]\n0,{k},0\n1,1,1\n", name=f"{k}.csv") for k in range(3)
    ]
    files = Files("mine", paths)
    assert files.read().states[:, 0, 0].tolist() == [0.0, 1.0, 2.0]
    assert files.recipe() != Files("mine", paths[:2]).recipe()
    assert files.recipe() == Files("other", paths).recipe()


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    missing=st.sets(st.integers(1, 38), max_size=16),
    count=st.integers(1, 3),
    samples=st.sampled_from([None, 7, 10, 13, 100]),
)
def test_no_window_crosses_what_is_missing_of_a_grid_and_nothing_is_lost(tmp_path, missing, count, samples):
    there = [k for k in range(40) if k not in missing]
    rows = [(b, 0.5 * k, float(k), float(b)) for b in range(count) for k in there]
    trajectories = read(tmp_path, table("id,t,q,v", rows), cut=samples).read()
    kept = trajectories.states[trajectories.present]
    assert sorted(map(tuple, kept.tolist())) == sorted((q, v) for _, _, q, v in rows)
    if np.median(np.diff(there)) != 1:  # then they lie on no grid
        return
    flat = trajectories.states.reshape(-1, 2)
    for first, length in zip(*(x.tolist() for x in segments(trajectories.present)), strict=True):
        run = flat[first : first + length, 0]
        assert bool((run.diff() == 1).all())
    assert sampling_interval(trajectories) == 0.5
    if samples == 10 and not missing:
        assert len(trajectories.states) == 4 * count


def test_a_long_step_among_irregular_ones_is_a_gap(tmp_path):
    draw = np.random.default_rng(0)
    steps = draw.uniform(0.5, 1.5, 40)
    steps[20] = 30.0
    rows = [(float(t), 0.0, 0.0) for t in np.concatenate(([0.0], steps.cumsum()))]
    filled = read(tmp_path, table("t,q,v", rows)).read()
    absent = int((~filled.present).sum())
    assert absent == round(30.0 / np.median(steps)) - 1
    assert len(segments(filled.present)[0]) == 2
    assert filled.times.isfinite().all()
    longest = float(filled.times.diff(dim=1).max())
    assert longest < 1.6
    whole = read(tmp_path, table("t,q,v", rows), gap=50.0).read()
    assert whole.present.all()
    assert sorted(filled.times[filled.present].tolist()) == whole.times[0].tolist()


def test_a_user_is_told_what_was_read(tmp_path, caplog):
    caplog.set_level(logging.INFO)
    rows = "".join(f"{name},{k},{k},1\n" for name, count in (("a", 3), ("b", 5)) for k in range(count))
    read(tmp_path, "id,t [s],x [km],vx [km/s]\n" + rows)
    expected = "2 trajectories of 3 to 5 samples, time in s, positions x in km, velocities vx"
    assert expected in caplog.text
    gone = rows.replace("b,2,2,1\n", "")  # an absent sample is none
    read(tmp_path, "id,t [s],x [km],vx [km/s]\n" + gone)
    assert expected.replace("3 to 5", "3 to 4") in caplog.text
    read(tmp_path, "t [s],x [km],px [kg km/s]\n0,1,2\n1,2,3\n", mass=1.0)
    assert "1 trajectory of 2 samples, time in s, positions x in km, momenta px" in caplog.text
    read(tmp_path, "t [s],x [km]\n0,1\n1,2\n")
    assert "1 trajectory of 2 samples, time in s, positions x in km only" in caplog.text


@pytest.mark.parametrize(("factor", "gap"), [(9, False), (12, True)])
def test_ten_usual_steps_are_a_gap_unless_told(tmp_path, factor, gap):
    steps = np.random.default_rng(0).uniform(0.8, 1.2, 60)
    steps[30] = factor * np.median(steps)
    rows = [(float(t), 0.0, 0.0) for t in steps.cumsum()]
    assert bool((~read(tmp_path, table("t,q,v", rows)).read().present).any()) == gap


def test_a_sidecar_names_the_object_of_a_table_without_ids_and_those_of_one_with_ids(tmp_path):
    header, rows = ["t [s]", "x [km]", "vx [km/s]"], [[0, 1, 2], [1, 2, 3], [2, 3, 4]]
    (tmp_path / "a.csv").write_text(csv_of(header, rows))
    (tmp_path / "b.csv").write_text(csv_of(["id", *header], [[one, *row] for one in "AB" for row in rows]))
    (tmp_path / "a.yaml").write_text("objects: {2026-001A: MYGTO}\n")
    (tmp_path / "b.yaml").write_text("objects: {B: MYLEO}\n")
    found = [
        [(track.name, track.title) for track in said(tmp_path / name)[0].tracks]
        for name in ("a.csv", "b.csv")
    ]
    assert found == [[("2026-001A", "MYGTO")], [("A", ""), ("B", "MYLEO")]]
