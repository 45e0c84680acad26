"""Figures of an assimilation: a band is not drawn where nothing was measured."""

from __future__ import annotations

import numpy as np
import pytest

from ahnn.assimilation.assimilation_record import AssimilationRecord
from ahnn.assimilation.stream_figures import innovations
from ahnn.types import Space


@pytest.mark.parametrize(("missing", "parts"), [(slice(0, 0), 1), (slice(40, 70), 2)])
def test_a_band_is_parted_at_a_gap(missing, parts):
    time = np.delete(np.arange(100.0), missing)
    count = len(time)
    one = np.ones((count, 1))
    outcome = np.full(count, "taken")
    record = AssimilationRecord(
        time,
        np.zeros((count, 2)),
        np.zeros((count, 2, 2)),
        outcome,
        one[:, 0],
        one[:, 0],
        ("q1",),
        0 * one,
        one,
    )
    (axes,) = innovations(record, Space("swing", ("q", "p"))).axes
    (band,) = axes.collections
    assert len(band.get_paths()) == parts
