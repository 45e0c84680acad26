"""Tracking data that are written as a message and read back, in both notations."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from made_formats import CRD, TABLE, kvn

from ahnn.errors import UserError
from ahnn.tracking.formats.crd import crd_data
from ahnn.tracking.formats.gathered import BOUNDS, TrackingReading, gathered
from ahnn.tracking.formats.station_table import table_data
from ahnn.tracking.formats.tdm import tdm_data
from ahnn.tracking.formats.tdm_writing import write_tdm
from ahnn.tracking.formats.tracking_sidecar import TrackingSidecar
from ahnn.tracking.tracking_data import KINDS, TrackingData

BOTH = pytest.mark.parametrize("name", ["a.tdm", "a.xml"])


def alike(one: TrackingData, other: TrackingData):
    assert (one.object, one.event, one.epoch) == (other.object, other.event, other.epoch)
    assert np.array_equal(one.times, other.times)
    assert [one.stations[k] for k in one.station] == [other.stations[k] for k in other.station]
    assert np.allclose(one.values, other.values, rtol=1e-15, atol=0, equal_nan=True)
    assert np.allclose(one.weather, other.weather, rtol=1e-15, atol=0, equal_nan=True)


@BOTH
def test_what_is_written_of_each_format_is_read_back(tmp_path, name):
    sources = [
        *crd_data(CRD, "a"),
        *table_data(TABLE, "a", TrackingSidecar(object="W3B")),
        *tdm_data(kvn(), "a"),
    ]
    for data in sources:
        write_tdm(tmp_path / name, [data])
        (found,) = tdm_data((tmp_path / name).read_text(), name)
        alike(found, data)


@given(
    values=arrays(float, (5, 6), elements=st.floats(0, 1)),
    steps=arrays(float, 4, elements=st.floats(1e-3, 1e5)),
    missing=arrays(bool, (5, 6)),
    event=st.sampled_from(["receive", "transmit"]),
    start=st.integers(10**8, 10**9),
)
def test_any_data_are_read_back(tmp_path_factory, values, steps, missing, event, start):
    path = tmp_path_factory.mktemp("made") / "a.xml"
    low, high = np.array([BOUNDS[kind] for kind in KINDS]).T
    missing[:, 0] = False
    scaled = np.where(missing, np.nan, low + values * (high - low))
    moments = start * 10**12 + np.round(np.concatenate(([0], steps.cumsum())) * 1e9).astype(object) * 10**3
    readings = [
        TrackingReading(int(m), f"S{k % 2}", dict(zip(KINDS, map(float, row), strict=True)), k)
        for k, (m, row) in enumerate(zip(moments, scaled, strict=True))
    ]
    data = gathered("A", readings, event)
    write_tdm(path, [data])
    (found,) = tdm_data(path.read_text(), path.name)
    order = np.argsort(found.station, kind="stable")
    assert len(order) >= 5
    merged = {}
    for time, station, row in zip(found.times, found.station, found.values, strict=True):
        known = merged.setdefault((time, found.stations[station]), np.full(6, np.nan))
        known[np.isfinite(row)] = row[np.isfinite(row)]
    for time, station, row in zip(data.times, data.station, data.values, strict=True):
        assert np.allclose(merged[time, data.stations[station]], row, rtol=1e-14, atol=1e-12, equal_nan=True)


def test_times_of_reflection_cannot_be_written(tmp_path):
    data = gathered("A", [TrackingReading(10**21, "S", {"range": 1.0}, 1)], "bounce")
    with pytest.raises(
        UserError, match="expected times of reception or transmission; received times of refl"
    ):
        write_tdm(tmp_path / "a.tdm", [data])
    assert not (tmp_path / "a.tdm").exists()
