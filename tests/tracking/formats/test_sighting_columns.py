"""Tables of tracking data in columns: the same measurements as in the plain notation."""

from __future__ import annotations

import numpy as np
import pytest
from entry import call

from ahnn.errors import UserError
from ahnn.tracking.formats.tracking_files import read_tracking

PLAIN = """2026-03-01T00:00:00 RANGE U 5000.5
2026-03-01T00:00:00 AZ_EL U 211.25 43.5
2026-03-01T00:01:00 RANGE_RATE V -1.25
2026-03-01T00:01:00 AZ_EL V 12.5 10.0
"""
COLUMNS = """# comment
time,station,range_km,azimuth_deg,elevation_deg,range_rate_km_s
2026-03-01T00:01:00,V,,12.5,10.0,-1.25
2026-03-01T00:00:00,U,5000.5,211.25,43.5,
2026-03-01T00:02:00,U,,,,
"""


@pytest.fixture
def table(tmp_path):
    (tmp_path / "seen.csv").write_text(COLUMNS)
    return tmp_path / "seen.csv"


def rows(path):
    """Of each time and station what was measured, in any order of rows."""
    (data,) = read_tracking(path)
    found = {}
    for t, s, values in zip(data.times, data.station, data.values, strict=True):
        whole = found.setdefault((t, data.stations[s]), np.full(6, np.nan))
        whole[np.isfinite(values)] = values[np.isfinite(values)]
    return found


def test_columns_say_what_lines_of_kinds_say(table, tmp_path):
    (tmp_path / "plain.aer").write_text(PLAIN)
    one, other = rows(table), rows(tmp_path / "plain.aer")
    assert {*one} == {*other} == {(0.0, "U"), (60.0, "V")}
    for key in one:
        assert np.allclose(one[key], other[key], rtol=1e-14, equal_nan=True)
    head = "epoch [UTC];sensor;range [m];azimuth [rad];elevation [rad];range_rate [m/s]"
    lines = [COLUMNS.replace(",", ";").splitlines()[k] for k in (3, 2)]
    cells = [line.split(";") for line in lines]
    for row in cells:
        for k, factor in ((2, 1e3), (3, np.pi / 180), (4, np.pi / 180), (5, 1e3)):
            row[k] = row[k] and repr(float(row[k]) * factor)
    table.write_text("\n".join([head, *map(";".join, cells)]))
    for key, values in rows(table).items():
        assert np.allclose(values, one[key], rtol=1e-13, equal_nan=True)


def test_satellites_units_of_the_sidecar_and_standard_deviations(table):
    table.write_text(
        "time,station,object,range,elevation,sd_range_m\n"
        "2026-03-01T00:00:00,U,a,5000,10,30\n2026-03-01T00:00:00,U,b,6000,11,\n"
    )
    table.with_suffix(".yaml").write_text(
        "{event: bounce, two_way: whole, units: {RANGE: m, AZ_EL: deg}, deviations: {RANGE: 10, AZ_EL: 0.1}}"
    )
    found = {data.object: data for data in read_tracking(table)}
    assert [*found] == ["a", "b"]
    assert {data.event for data in found.values()} == {"bounce"}
    assert found["a"].values[0, 0] == pytest.approx(2.5, rel=1e-14)
    sds = [found[name].deviations[0, [0, 2]].tolist() for name in "ab"]
    assert sds[0] == pytest.approx([0.015, np.radians(0.1)], rel=1e-14)
    assert sds[1] == pytest.approx([0.005, np.radians(0.1)], rel=1e-14)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("range_km", "range", "row 2, column range: expected a unit, such as range [km]; received none"),
        (
            "range_km",
            "range_deg",
            "column range: expected range in km, or in a compatible unit; received 'deg'",
        ),
        ("range_km", "rnage_km", "declination; received 'rnage_km'; did you mean 'range"),
        ("azimuth_deg", "elevation", "declination; received 'elevation'"),
        ("time,", "t [UT1],", "column t: expected one of the time scales UTC, TAI, GPS, TT; received 'UT1'"),
        ("station,", "epoch,", "row 2, column station: expected a column station with the name of the"),
        (",U,5", ",,5", "row 4, column station: expected a station name; received none"),
        ("43.5", "93.5", "row 4, column elevation: expected a number from -90 to 90"),
        ("00:01:00,V", "00:61:00,V", "row 3, column time: expected a time of day"),
    ],
)
def test_what_is_wrong_is_refused(table, old, new, said):
    assert old in COLUMNS
    table.write_text(COLUMNS.replace(old, new, 1))
    with pytest.raises(UserError) as caught:
        read_tracking(table)
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("typical", "mistake"), [(4_780_837, "metres given as km?"), (4.78, "kilometres given as m?"), (4780, "")]
)
def test_ranges_that_no_earth_satellite_has_are_told(table, caplog, capsys, typical, mistake):
    lines = [f"2026-03-01T00:0{k}:00,{'UV'[k % 2]},{typical + k if k % 2 else 5000},10,10" for k in range(6)]
    table.write_text("\n".join(["time,station,range_km,azimuth_deg,elevation_deg", *lines]))
    read_tracking(table)
    said = [record.getMessage() for record in caplog.records]
    assert len(said) == bool(mistake)
    if mistake:
        assert f"{table}, column range: ranges of V of typically {typical + 3:,.4g} km" in said[0]
        assert said[0].endswith(mistake)
    assert call("ahnn.data.__main__", "check", str(table)) == 0
    assert f"0 faults, {1 if mistake else 0} warning" in capsys.readouterr().out


def test_sightings_without_stations_are_one_fault_unless_they_are_coordinates(table, capsys):
    rows = [f"{60 * k},{5000 + k},{10 + k},{20 + k}" for k in range(9)]
    table.write_text("\n".join(["time,range_km,azimuth_deg,elevation_deg", *rows, *rows]))
    assert call("ahnn.data.__main__", "check", str(table)) == 2
    assert "1 fault, 0 warnings" in capsys.readouterr().out
    with pytest.raises(UserError, match="column station: expected a column station with the name"):
        read_tracking(table)
    table.write_text("\n".join(["time,range,azimuth,elevation", *rows]))
    table.with_suffix(".yaml").write_text("columns: {time: time, positions: [range, azimuth, elevation]}")
    call("ahnn.data.__main__", "check", str(table))
    assert "column station" not in " ".join(capsys.readouterr().out.split())
