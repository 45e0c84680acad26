"""Standard deviations and covariances in a table of starts: of the state that counts, or refused."""

from __future__ import annotations

import pytest
import torch

from ahnn.data.files.units import product
from ahnn.data.starts import starts
from ahnn.errors import UserError
from ahnn.types import Space, Units

SPACE = Space("rail", ("q", "p"), Units("s", "m", "m/s", "J"), 2.0)
HEAD = "id,t [s],q [m],vq [m/s],sd_q,sd_vq"
ROWS = ["a,0,1,2,0.1,0.01", "b,3,5,6,0.3,0.03", "a,7,3,4,0.2,0.02"]


def read(tmp_path, *lines, **options):
    """The starts of a table."""
    (tmp_path / "it.csv").write_text("\n".join(lines) + "\n")
    return starts(str(tmp_path / "it.csv"), SPACE, **options)


@pytest.mark.parametrize(("last", "a"), [(True, (0.2, 0.02)), (False, (0.1, 0.01))])
def test_they_are_those_of_the_state_that_counts(tmp_path, last, a):
    found = read(tmp_path, HEAD, *ROWS, last=last)
    assert found.names == ("a", "b")
    expected = torch.tensor(
        [[a[0], 2 * a[1]], [0.3, 2 * 0.03]], dtype=torch.float64
    )  # momenta: the mass is 2
    assert torch.allclose(found.covariances, expected.square().diag_embed(), rtol=1e-14)
    assert found.times.tolist() == ([7.0, 3.0] if last else [0.0, 3.0])


def test_units_are_those_of_the_columns_and_epochs_may_be_times(tmp_path):
    rows = ["2024-03-01T12:00:00,1,2,0.1,0.01", "2024-03-01T12:00:07,3,4,0.2,0.02"]
    found = read(tmp_path, "t,q [km],vq [km/s],sd_q [km],sd_vq", *rows, last=True)
    sds = found.covariances[0].diagonal().sqrt()
    assert torch.allclose(sds, torch.tensor([200.0, 40.0], dtype=torch.float64), rtol=1e-14)
    with pytest.raises(UserError, match=r"sd_q: expected the unit of q, km; received m"):
        read(tmp_path, "t,q [km],vq [km/s],sd_q [m],sd_vq", *rows)


def test_some_alone_are_refused_and_exact_states_have_none(tmp_path, caplog):
    with pytest.raises(UserError, match="expected sd_vq with the other standard deviations; received none"):
        read(tmp_path, "t,q,vq,sd_q", "0,1,2,0.1")
    assert read(tmp_path, "t,q,vq,sd_q,sd_vq", "0,1,2,0,0", "1,1,2,0.1,0.1").covariances is None
    assert "the standard deviations are not used" in caplog.text
    given = read(tmp_path, HEAD, *ROWS, sd=[0.5, 0.25])
    assert given.covariances[1].diagonal().sqrt().tolist() == pytest.approx([0.5, 0.25], rel=1e-14)


def test_covariances_come_before_standard_deviations_in_the_units_of_the_columns(tmp_path):
    head = "id,t [s],q [km],vq [km/s],sd_q [km],sd_vq,cov_q_q [km^2],cov_vq_q [km km/s],cov_vq_vq"
    found = read(tmp_path, head, "a,0,1,2,9,9,0.04,-0.006,0.01")
    expected = torch.tensor([[4e4, -2 * 6e3], [-2 * 6e3, 4 * 1e4]], dtype=torch.float64)  # mass 2
    assert torch.allclose(found.covariances[0], expected, rtol=1e-14)
    with pytest.raises(UserError, match=r"cov_q_q: expected the unit of q, km\^2; received m\^2"):
        read(tmp_path, head.replace("[km^2]", "[m^2]"), "a,0,1,2,9,9,0.04,-0.006,0.01")
    with pytest.raises(UserError, match="expected cov_vq_vq with the other covariances; received none"):
        read(tmp_path, head.removesuffix(",cov_vq_vq"), "a,0,1,2,9,9,0.04,-0.006")


def test_the_unit_of_a_product():
    assert [product("km", "km/s"), product("rad", "rad"), product("m/s", "m/s")] == [
        "km^2/s",
        "rad^2",
        "m^2/s^2",
    ]
    assert [product("1", "1"), product("1", "1/s"), product("m", "ohm/s")] == ["1", "1/s", "m * (ohm/s)"]
    assert product("kg m²/s", "rad") == "kg m^2 rad/s"
