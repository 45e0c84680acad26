"""Plain tables of measurements, and the sidecars that say what they leave open."""

from __future__ import annotations

import numpy as np
import pytest
from made_formats import REAL, SIDECAR, TABLE
from made_orbits import CPF

from ahnn.data.files import instant
from ahnn.errors import UserError
from ahnn.tracking.formats.tracking_files import read_tracking
from ahnn.tracking.tracking_data import KINDS


@pytest.fixture
def table(tmp_path):
    (tmp_path / "a.aer").write_text(TABLE)
    return tmp_path / "a.aer"


def test_kinds_stations_and_times(table):
    (data,) = read_tracking(table)
    assert (data.object, data.stations, data.event) == ("", ("Uralla", "Kumsan"), "receive")
    assert data.station.tolist() == [0, 1, 0, 0, 1, 0]
    assert data.epoch == instant("2010-11-02T03:00:13.3851", utc=True)
    assert data.times[1] == pytest.approx(37.1865, rel=1e-14)
    assert data.values[0, 0] == 38014.9488
    assert np.allclose(np.degrees(data.values[1, 1:3]), [211.1446, 43.4099], rtol=1e-14)
    assert data.values[4, KINDS.index("range_rate")] == -1.25
    assert np.allclose(np.degrees(data.values[5, 4:6]), [298.0329, -30.1641], rtol=1e-14)
    assert np.isnan(data.values[0, 1:]).all()
    assert "no sidecar: AZ_EL in deg, RANGE in km" in data.remarks[0]


def test_a_sidecar_says_units_object_clock_event_and_deviations(table):
    said = "object: W3B\nclock: GPS\nevent: transmit\ntwo_way: whole\nunits: {RANGE: m, AZ_EL: rad}\n"
    table.write_text("2010-11-02T03:00:13 RANGE U 5000.0\n2010-11-02T03:00:14 AZ_EL U 1.5 0.5\n")
    table.with_suffix(".yaml").write_text(said + "deviations: {RANGE: 2, AZ_EL: 0.001}\n")
    (data,) = read_tracking(table)
    assert (data.object, data.event, data.remarks) == ("W3B", "transmit", ())
    assert data.epoch == instant("2010-11-02T02:59:58", utc=True)  # GPS time was 15 s ahead of UTC
    assert data.values[0, 0] == 2.5
    assert data.values[1, 1:3].tolist() == [1.5, 0.5]
    assert data.deviations[0, 0] == pytest.approx(1e-3)
    assert data.deviations[1, 1:3].tolist() == [0.001, 0.001]
    other = table.with_name("other.yml")
    other.write_text(SIDECAR)
    (data,) = read_tracking(table, other)
    assert (data.values[0, 0], data.event) == (5000.0, "receive")


def test_a_sidecar_takes_the_names_of_columns_and_stations_too(table):
    table.write_text("2010-11-02T03:00:13 RANGE U 5000.0\n2010-11-02T03:00:14 AZ_EL U 90 45\n")
    table.with_suffix(".yaml").write_text(
        "units: {range: m}\ndeviations: {range: 2, azimuth: 0.02, elevation: 0.01}\n"
    )
    (data,) = read_tracking(table)
    assert data.values[0, 0] == 5.0
    assert data.deviations[0, 0] == pytest.approx(2e-3)
    assert np.degrees(data.deviations[1, 1:3]).tolist() == pytest.approx([0.02, 0.01])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("units: {RANGE: ft}", "column units: range: expected one of km, m; received 'ft'"),
        (
            "units: {RANGES: m}",
            "for different kinds among RANGE, RANGE_RATE, AZ_EL, RA_DEC, range",
        ),
        ("deviations: {AZ_EL: 0.1, azimuth: 0.2}", "expected values for different kinds"),
        ("unit: {RANGE: m}", "received 'unit'; did you mean 'units'?"),
        ("clock: UT1", "column clock: expected one of UTC, TAI, GPS, TT; received 'UT1'"),
        ("event: arrival", "column event: expected one of receive, transmit, bounce"),
        ("two_way: [half]", "column two_way: expected one of half, whole"),
        ("deviations: {RANGE: -1}", "column deviations: range: expected a number above 0; received -1"),
        ("deviations: {RANGE: .nan}", "expected a number above 0"),
        ("{", "expected YAML"),
    ],
)
def test_a_wrong_sidecar_is_refused(table, text, said):
    table.with_suffix(".yaml").write_text(text)
    with pytest.raises(UserError) as caught:
        read_tracking(table)
    assert str(caught.value).startswith(str(table.with_suffix(".yaml")))
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("38014.9488", "380x4", "row 2, column range: expected a number; received '380x4'"),
        ("38014.9488", "-38014", "row 2, column range: expected a number from 0.001 to 1e+10"),
        ("43.4099", "93.4099", "row 3, column elevation: expected a number from -90 to 90"),
        (
            "   43.4099",
            "",
            "row 3: expected epoch, AZ_EL, station and azimuth and elevation; received 4 values",
        ),
        ("T03:00:13.3851", "T33:00:13.3851", "row 2, column epoch: expected a time of day"),
        ("2010-11-02T03:00:13", "1010-11-02T03:00:13", "expected an epoch from 1972 to 2200"),
        (
            "RANGE       Uralla         37949",
            "DELAY Uralla 37949",
            "row 5: expected an epoch and one of RANGE",
        ),
    ],
)
def test_a_wrong_line_is_refused_or_noted(table, old, new, said):
    assert old in TABLE
    table.write_text(TABLE.replace(old, new, 1))
    with pytest.raises(UserError) as caught:
        read_tracking(table)
    assert said in str(caught.value)
    faults = []
    (data,) = read_tracking(table, note=faults.append)
    assert (len(data.times), len(faults)) == (5, 1)


def test_angles_are_from_minus_half_a_turn_to_a_whole_one(table):
    for low, high in (("-180", "-90"), ("360", "90")):
        table.write_text(f"2010-11-02T03:00:13 AZ_EL U {low} {high}\n")
        (data,) = read_tracking(table)
        assert np.degrees(data.values[0, 1:3]).tolist() == pytest.approx([float(low), float(high)], rel=1e-14)
    for azimuth in ("-180.1", "360.1"):
        table.write_text(f"2010-11-02T03:00:13 AZ_EL U {azimuth} 45\n")
        with pytest.raises(UserError, match="column azimuth: expected a number from -180 to 360"):
            read_tracking(table)


def test_other_formats_are_refused_by_name(tmp_path):
    (tmp_path / "a.aer").write_text(CPF)
    with pytest.raises(UserError, match=r"received laser ranging predictions \(CPF\)"):
        read_tracking(tmp_path / "a.aer")


@pytest.mark.skipif(not REAL.is_dir(), reason="no real files beside the checkout")
def test_the_real_table():
    (data,) = read_tracking(REAL / "w3b" / "W3B.aer")
    counts = np.isfinite(data.values).sum(0).tolist()
    assert counts == [182, 339, 339, 0, 0, 0]
    assert len(data.stations) == 5
    assert data.times[-1] == pytest.approx(56840.1805, rel=1e-12)
