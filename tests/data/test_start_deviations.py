"""Standard deviations in a table of starts: of the state that counts, in any unit, or refused."""

from __future__ import annotations

import pytest
import torch

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
