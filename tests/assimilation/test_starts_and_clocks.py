"""Where a stream begins and what its times mean: starts of every kind, epochs, frames, what is missing."""

from __future__ import annotations

import pytest
import torch
from following import SENSORS, SPACE
from test_stream_of_lines import ORBIT

from ahnn.assimilation.cells import BadLine
from ahnn.assimilation.line_parser import Layout
from ahnn.assimilation.start import belief_of
from ahnn.assimilation.stream_clock import StreamClock
from ahnn.data.files import instant
from ahnn.data.reference import Reference
from ahnn.data.starts import starts
from ahnn.errors import UserError


def never(*_):
    """Carries no covariance."""
    raise AssertionError


def test_a_start_is_read_from_values_files_and_messages(tmp_path):
    (tmp_path / "a.yaml").write_text("mean: [1, 2]\nsd: [0.1, 0.2]\n")
    (tmp_path / "b.json").write_text('{"mean": [1, 2], "covariance": [[0.01, 0], [0, 0.04]]}')
    found = [starts(str(tmp_path / name), SPACE) for name in ("a.yaml", "b.json")]
    found.append(starts([1.0, 2.0], SPACE, sd=[0.1, 0.2]))
    for start in found:
        belief = belief_of(start, None, SPACE, never)
        assert torch.allclose(
            belief.covariance[0], torch.diag(torch.tensor([0.01, 0.04]).double()), rtol=1e-14
        )
    belief = belief_of(starts([0.0] * 6, ORBIT, sd=[3.0, 0.5]), None, ORBIT, never)
    assert torch.equal(belief.chol[0].diagonal(), torch.tensor([3, 3, 3, 1, 1, 1]).double())
    for given_, sd in (
        ([1.0], [1.0, 1.0]),
        (None, [1.0, 1.0]),
        ([1.0, 2.0], None),
        ([[1.0, 2.0]] * 2, [1, 1]),
    ):
        with pytest.raises(UserError, match=r"^start"):
            belief_of(starts(given_, SPACE, sd=sd), None, SPACE, never)
    with pytest.raises(UserError, match=r"none\.yaml: No such file"):
        starts("none.yaml", SPACE)


def test_epochs_count_from_time_zero_with_leap_seconds():
    clock = StreamClock("min", instant("2016-12-31T23:00:00", utc=True), "UTC")
    table = Layout("time [UTC],sensor,q [m],p", SENSORS, clock)
    name = next(iter(SENSORS))
    assert table.reading(f"2017-01-01T00:00:00.5,{name},1,").time == pytest.approx(60 + 1.5 / 60, rel=1e-15)
    assert table.reading(f"30,{name},1,").time == 30.0
    with pytest.raises(BadLine, match=r"time: expected an epoch such as .*; received '2017-13T'"):
        table.reading(f"2017-13T,{name},1,")
    seconds = Layout("t [s],sensor,q [m],p", SENSORS, clock)
    assert seconds.reading(f"90,{name},1,").time == pytest.approx(1.5, rel=1e-15)
    with pytest.raises(
        UserError, match=r"expected times in min, in another unit of time, or .*; received kg\."
    ):
        Layout("time [kg],sensor,q", SENSORS, clock)
    with pytest.raises(UserError, match=r"epoch: expected an epoch such as"):
        Reference().since("yesterday")
