"""The output of an assimilation as a start: its last row, in the units of a model."""

from __future__ import annotations

import csv
import json

import pytest
import torch

from ahnn.data.estimate_table import (
    FIRST,
    components_with_units,
    described,
    is_track,
    last_estimates,
    units_of,
)
from ahnn.data.files import instant
from ahnn.data.files.sidecar import beside, parse, write
from ahnn.data.reference import Reference
from ahnn.data.starts import of_one_state, starts
from ahnn.errors import UserError
from ahnn.types import Space, Units

SPACE = Space("cart", ("x", "y", "px", "py"), Units("min", "km", "km/min", "J"), inertia=2.0)
LOWER = [(i, j) for i in range(4) for j in range(i + 1)]
MATRIX = torch.arange(1.0, 17.0, dtype=torch.float64).reshape(4, 4)
MATRIX = torch.tril(MATRIX) + torch.tril(MATRIX, -1).T
NAMES = [f"cov_{SPACE.components[i]}_{SPACE.components[j]}" for i, j in LOWER]


def row(time, scale):
    numbers = dict(zip(NAMES, [scale * float(MATRIX[i, j]) for i, j in LOWER], strict=True))
    about = dict(zip(FIRST, (7, time, "gps", "used", 0, 1.5, 2), strict=True))
    return about | {name: scale * (k + 0.1) for k, name in enumerate(SPACE.components)} | numbers


ROWS = [row(1.0, 5.0), row(2.5, 1.0)]


def table(path, rows=ROWS, names=None):
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, names or [*(*rows, row(0.0, 1.0))[0]], extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    return path


def lines(path, rows=ROWS):
    path.write_text("".join(json.dumps(one) + "\n" for one in rows))
    return path


@pytest.mark.parametrize("write", [table, lines])
def test_the_last_row_is_the_estimate(tmp_path, write):
    path = write(tmp_path / "out")
    assert is_track(path)
    found = last_estimates(path, SPACE)
    assert (found.names, found.times.tolist()) == ((), [2.5])
    assert found.means.tolist() == [[0.1, 1.1, 2.1, 3.1]]
    assert torch.equal(found.covariances, MATRIX[None])
    assert found.means.dtype == found.covariances.dtype == torch.float64
    assert found.reference == Reference()


@pytest.mark.parametrize("write", [table, lines])
def test_many_objects_have_a_last_row_each_also_of_a_late_line_at_the_same_time(tmp_path, write):
    names = "007", "Ñandú, A/1", "007", "007"
    pairs = zip(names, (9.0, 2.0, 3.0, 1.0), (1.0, 2.0, 2.5, 2.5), strict=True)
    rows = [{"line": 1, "object": name} | row(time, scale) for name, scale, time in pairs]
    path = write(tmp_path / "out", rows)
    assert is_track(path)
    found = starts(str(path), SPACE)
    assert (found.names, found.times.tolist()) == (("007", "Ñandú, A/1"), [2.5, 2.0])
    assert found.states[:, 1].tolist() == [1.1, 2.2]
    assert torch.equal(found.covariances, torch.stack((MATRIX, 2 * MATRIX)))
    assert not of_one_state(str(path))
    assert of_one_state(str(table(tmp_path / "one.csv")))


def test_other_files_are_no_outputs(tmp_path):
    (tmp_path / "data.csv").write_text("time,x\n0,1\n")
    (tmp_path / "data.json").write_text('{"mean": [1, 2]}\n')
    assert not any(is_track(path) for path in (*tmp_path.iterdir(), tmp_path, tmp_path / "none"))


@pytest.mark.parametrize(
    ("rows", "names", "received"),
    [
        ([], None, "no row"),
        (ROWS, [*FIRST, *SPACE.components], "an invalid row .'cov_x_x'"),
        (ROWS, [*FIRST, *SPACE.components[1:], *NAMES], "an invalid row .'x'"),
        ([{**ROWS[0], "y": "far"}], None, "an invalid row .could not convert"),
    ],
)
def test_an_output_without_an_estimate_is_refused(tmp_path, rows, names, received):
    path = table(tmp_path / "out.csv", rows, names)
    with pytest.raises(
        UserError, match=rf"start .*: expected estimates of x, y, px, py; received {received}"
    ):
        last_estimates(path, SPACE)


def test_units_and_frame_are_those_of_the_sidecar(tmp_path):
    path = table(tmp_path / "out.csv")
    ours = Reference("EME2000", "EARTH", "UTC", instant("2024-03-01T12:00:00", utc=True))
    write(path, described(SPACE, ours))
    assert beside(path) == tmp_path / "out.yaml"
    assert beside(path).is_file()
    assert last_estimates(path, SPACE).reference == ours
    said = parse(beside(path).read_text(), "out.yaml")
    assert said.units == units_of(SPACE)
    metres = SPACE._replace(units=SPACE.units._replace(position="m"))
    with pytest.raises(UserError, match="expected x in m, as in the model; received km"):
        last_estimates(path, metres)


@pytest.mark.parametrize(
    ("units", "momentum"),
    [
        (Units("min", "km", "km/min", "J"), "kg km/min"),
        (Units("s", "rad", "rad/s", "J"), "kg m^2/s"),
        (Units("1", "1", "1", "1"), "1"),
    ],
)
def test_tracks_have_velocities_and_momenta_only_where_these_are_none(units, momentum):
    space = SPACE._replace(units=units)
    positions = {"time": units.time, "x": units.position, "y": units.position}
    assert units_of(space) == {**positions, "vx": units.velocity, "vy": units.velocity}
    assert units_of(space._replace(mechanical=False)) == {**positions, "px": momentum, "py": momentum}


def test_components_have_the_units_of_numbers_of_a_start():
    space = SPACE._replace(inertia=(2.0, 1.0), angles=("y",), units=Units("s", "m", "m/s", "J"))
    assert components_with_units(space) == ["x [m]", "y [rad]", "px [m/s x 2]", "py [rad/s]"]
    kept = SPACE._replace(mechanical=False, units=Units("s", "rad", "rad/s", "J"))
    assert components_with_units(kept)[2:] == ["px [kg m²/s]", "py [kg m²/s]"]


def test_an_output_is_a_start_at_its_last_time(tmp_path):
    found = starts(str(lines(tmp_path / "out")), SPACE)
    assert (found.names, found.times.tolist()) == (("1",), [2.5])
    assert found.states.tolist() == [[0.1, 1.1, 2.1, 3.1]]
    assert torch.equal(found.covariances, MATRIX[None])
    (tmp_path / "infinite").write_text(json.dumps({**ROWS[0], "x": "inf"}))
    with pytest.raises(UserError, match="start"):
        starts(str(tmp_path / "infinite"), SPACE)
