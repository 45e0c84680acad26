"""Figures of an assimilation: gaps stay open, sensors have colours, far outliers have other marks."""

from __future__ import annotations

import numpy as np
import pytest

from ahnn.assimilation.assimilation_record import AssimilationRecord
from ahnn.assimilation.stream_figures import innovations
from ahnn.types import Space

SWING = Space("swing", ("q", "p"))


def drawn(time, innovation, outcome, sensor):
    """The axes of the innovations of a range with standard deviations of 1."""
    count, one = len(time), np.ones((len(time), 1))
    estimates = np.zeros((count, 2)), np.zeros((count, 2, 2))
    known = one[:, 0], one[:, 0], ("range",), innovation[:, None], one
    (axes,) = innovations(
        AssimilationRecord(time, *estimates, np.array(outcome), *known, np.array(sensor)),
        SWING,
        {"range": "km"},
    ).axes
    return axes


@pytest.mark.parametrize(("missing", "parts"), [(slice(0, 0), 1), (slice(40, 70), 2)])
def test_a_band_is_parted_at_a_gap(missing, parts):
    time = np.delete(np.arange(100.0), missing)
    count = len(time)
    axes = drawn(time, np.zeros(count), ["taken"] * count, ["position"] * count)
    (band,) = axes.collections
    assert len(band.get_paths()) == parts
    assert axes.get_ylabel() == "range [km]"


def test_each_sensor_has_its_colour():
    axes = drawn(np.arange(4.0), np.arange(4.0), ["taken"] * 4, ["north", "south", "north", "south"])
    lines = {line.get_label(): line for line in axes.lines}
    assert lines["north"].get_ydata().tolist() == [0.0, 2.0]
    assert lines["south"].get_ydata().tolist() == [1.0, 3.0]
    assert lines["north"].get_color() != lines["south"].get_color()


def test_a_rejected_number_beyond_the_axis_is_marked_as_such():
    """The axis ends at twice the band of three: 6."""
    outcome = ["taken", "rejected", "rejected", "rejected"]
    axes = drawn(np.arange(4.0), np.array([0.5, 5.0, 40.0, -9.0]), outcome, ["position"] * 4)
    found = {line.get_label(): [*line.get_ydata()] for line in axes.lines}
    assert found["rejected"] == [5.0]
    assert found["rejected, above the axis"] == [6.0]
    assert found["rejected, below the axis"] == [-6.0]
