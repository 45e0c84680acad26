"""Headers of streams: what the units of angles say about a steep elevation, and names of the time column."""

from __future__ import annotations

import pytest

from ahnn.assimilation import StreamSensor
from ahnn.assimilation.cells import BadLine
from ahnn.assimilation.line_parser import Layout
from ahnn.assimilation.stream_clock import StreamClock
from ahnn.assimilation.table_parser import TableParser
from ahnn.data.files import instant
from ahnn.errors import UserError
from ahnn.measurements import GroundStation, Position
from ahnn.types import Space, Units

ORBIT = Space("orbit", ("x", "y", "z", "px", "py", "pz"), Units("s", "km", "km/s", "km**2/s**2"))
STATION = StreamSensor.of(GroundStation(50.0, 10.0), [0.1, 1e-4, 1e-4], ORBIT)


def said(header, line, before=()):
    """Return the message on a line after others."""
    layout = Layout(header, {"kiruna": STATION})
    for text in before:
        layout.reading(text)
    with pytest.raises(BadLine if before else UserError) as caught:
        layout.reading(line)
    return str(caught.value)


def test_a_steep_elevation_is_given_in_the_unit_of_its_column():
    degrees = "time,range [km],azimuth [deg],elevation [deg]"
    expected = "elevation: expected at most 90 deg; received 247.522 deg. The columns azimuth and elevation "
    assert said(degrees, "1,3858.7,16.0,247.522") == expected + "may be exchanged"
    assert said(degrees, "1,3858.7,16.0,247.522", ["0,3858.7,247.5,16.0"]) == expected + "may be exchanged"
    radians = "elevation: expected at most pi/2 rad; received 4.32. If the values are in degrees, name the "
    for unit in ("", " [rad]"):
        header = f"time,range,azimuth{unit},elevation{unit}"
        assert said(header, "1,3858.7,0.28,4.32") == radians + "column elevation [deg]"


@pytest.mark.parametrize(
    "header", ["t_min,range_m,azimuth_deg,elevation_deg", "time_min,range_m,azimuth,elevation"]
)
def test_names_of_columns_may_end_with_their_units(header):
    turn = 57.29577951308232 if "deg" in header else 1.0
    layout = Layout(header, {"kiruna": STATION}, StreamClock("s", None, "UTC"))
    found = layout.reading(f"2,3858700,{0.28 * turn},{0.32 * turn}")
    assert (found.time, found.values) == (120.0, pytest.approx((3858.7, 0.28, 0.32)))


def test_a_column_epoch_is_the_time_of_a_stream():
    clock = StreamClock("s", instant("2024-03-01T12:00:00", utc=True), "UTC")
    date, numbers = "2024-03-01T12:01:00", "3858.7,0.28,0.32"
    layout = Layout("epoch,sensor,range,azimuth,elevation", {"kiruna": STATION}, clock)
    line = f"{date},kiruna,{numbers}"
    assert layout.reading(line).time == 60.0
    assert TableParser(layout, STATION.columns).of_lines([2], [line]).table.times.tolist() == [60.0]
    layout = Layout("{", {"kiruna": STATION}, clock)
    line = f'{{"epoch": "{date}", "range": 3858.7, "azimuth": 0.28, "elevation": 0.32}}'
    assert layout.reading(line).time == 60.0
    for other in ("time", "t"):
        with pytest.raises(UserError, match=r"expected a header with time and .*, each once"):
            Layout(f"epoch,{other},range", {"kiruna": STATION}, clock)


def test_a_missing_column_of_a_sensor_is_named_once(caplog):
    Layout("time,range,azimuth", {"kiruna": STATION})
    assert caplog.messages == ["measurements: no column elevation, so its values are missing"]
    caplog.clear()
    two = {"kiruna": STATION, "fix": StreamSensor.of(Position(3), 0.1, ORBIT)}
    Layout("time,sensor,x,y", two)
    assert caplog.messages == ["measurements: no column z of fix, so its values are missing"]
    caplog.clear()
    Layout("time,range,azimuth,elevation", {"kiruna": STATION})
    assert caplog.messages == []
