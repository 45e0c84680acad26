"""Controls in files and in Python: read, held or interpolated through gaps, and what does not fit."""

from __future__ import annotations

import pytest
import torch

from ahnn.data import Files
from ahnn.data.sources import Given
from ahnn.errors import UserError
from ahnn.types import Space, Trajectories

HEAD = "id,t [s],x [m],v [m/s],u [N]\n"
ROWS = "a,0,0,1,5\na,1,1,2,6\na,2,1,2,7\na,5,2,3,10\nb,0,1,1,-1\nb,1,2,2,-2\nb,2,3,3,-3\n"
SPACE = Space("mine", ("q", "p"), controls=("u", "w"))


def files(folder, text=HEAD + ROWS, sidecar=None, **options):
    path = folder / "data.csv"
    path.write_text(text)
    if sidecar is not None:
        path.with_suffix(".yaml").write_text(sidecar)
    return Files("mine", str(path), **options)


def given(controls, **options):
    states = torch.arange(12.0).reshape(2, 3, 2)
    return Given(Trajectories(states, torch.arange(3.0), controls, **options), SPACE)


def test_controls_of_a_file_are_held_through_a_gap_and_end_with_their_trajectory(tmp_path):
    source = files(tmp_path)
    found = source.read()
    assert source.space.controls == ("u",)
    assert source.space.components == ("x", "px")
    assert found.controls is not None
    assert found.controls[0, :, 0].tolist() == [5, 6, 7, 7, 7, 10]
    assert found.controls[1, :3, 0].tolist() == [-1, -2, -3]
    assert bool(found.controls[1, 3:].isnan().all())
    assert not found.linear


def test_a_sidecar_names_controls_and_interpolates_them(tmp_path):
    named = "columns: {time: t, id: id, positions: [x], velocities: [v], controls: [u]}\ncontrols: linear\n"
    found = files(tmp_path, sidecar=named).read()
    assert found.controls is not None
    assert found.controls[0, :, 0].tolist() == [5, 6, 7, 8, 9, 10]
    assert found.linear
    clock = found.clock(2)
    assert clock is not None
    assert clock.rates[0, :5, 1].tolist() == [1] * 5


def test_cuts_keep_the_controls_of_their_samples(tmp_path):
    text = HEAD + "".join(f"a,{k},{k % 3},{k},{10 * k}\n" for k in range(12))
    found = files(tmp_path, text, cut=4).read()
    assert found.controls is not None
    assert found.controls[..., 0].tolist() == (10 * found.times).tolist()


@pytest.mark.parametrize(
    ("text", "sidecar", "message"),
    [
        (
            HEAD + ROWS.replace(",6\n", ",\n"),
            None,
            r"row 3, column u: expected a control in each row; received none",
        ),
        (HEAD + ROWS, "controls: cubic\n", "expected controls: held or linear; received 'cubic'"),
    ],
)
def test_a_control_that_is_missing_and_another_rule_are_refused(tmp_path, text, sidecar, message):
    with pytest.raises(UserError, match=message):
        files(tmp_path, text, sidecar)


def test_a_name_of_controls_alone_is_a_position(tmp_path):
    assert files(tmp_path, "t,u\n0,1\n1,2\n2,4\n").space.components == ("u", "pu")


def test_controls_in_python_pass_as_they_are_and_count_in_the_recipe():
    controls = torch.arange(12.0).reshape(2, 3, 2)
    source = given(controls)
    found = source.read()
    assert found.controls is not None
    assert torch.equal(found.controls, controls.double())
    assert source.space.controls == ("u", "w")
    recipes = [given(controls), given(controls + 1), given(controls, linear=True)]
    assert len({str(one.recipe()) for one in recipes}) == 3


@pytest.mark.parametrize(
    ("controls", "message"),
    [
        (None, r"controls: expected shape \(2, 3, 2\), as space.controls names u, w; received None"),
        (torch.zeros(2, 3, 1), r"controls: expected shape \(2, 3, 2\)"),
        (torch.full((2, 3, 2), torch.nan), "at each time; received .*nan.* at sample 0 of trajectory 0"),
    ],
)
def test_controls_of_another_shape_or_missing_are_refused(controls, message):
    with pytest.raises(UserError, match=message):
        given(controls)


def test_controls_of_a_space_without_any_are_refused():
    states = torch.arange(12.0).reshape(2, 3, 2)
    with pytest.raises(UserError, match="names none"):
        Given(Trajectories(states, torch.arange(3.0), torch.zeros(2, 3, 1)), Space("mine", ("q", "p")))


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("u", "u"), "space.controls: expected different names; received 'u' twice"),
        (("q", "u"), "space.controls: expected different names; received 'q' twice"),
        (("", "u"), "expected printable names and units"),
    ],
)
def test_names_of_controls_are_their_own(names, said):
    with pytest.raises(UserError, match=said):
        Given(
            Trajectories(torch.zeros(1, 3, 2), torch.arange(3.0), torch.zeros(1, 3, 2)),
            SPACE._replace(controls=names),
        )


def test_files_whose_controls_have_other_units_do_not_fit(tmp_path):
    (tmp_path / "a.csv").write_text(HEAD + ROWS)
    (tmp_path / "b.csv").write_text(HEAD.replace("[N]", "[kN]") + ROWS)
    with pytest.raises(UserError, match=r"expected controls u \[N\], as in .*a.csv; received u \[kN\]"):
        Files("mine", [str(tmp_path / "a.csv"), str(tmp_path / "b.csv")])
