"""Tracking data messages in both notations: units, events, angles, corrections; what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from made_formats import DATA, META, kvn, xml

from ahnn.data.files import instant
from ahnn.errors import UserError
from ahnn.tracking.formats.tdm import tdm_data
from ahnn.tracking.formats.tracking_files import read_tracking
from ahnn.tracking.tracking_data import KINDS

LIGHT = 299792.458
BOTH = pytest.mark.parametrize("notation", [kvn, xml])


def values(data, kind):
    column = data.values[:, KINDS.index(kind)]
    return column[np.isfinite(column)]


@BOTH
def test_measurements_of_a_moment_are_together(notation):
    (data,) = tdm_data(notation(), "a.tdm")
    assert (data.object, data.stations, data.event) == ("2024-001A", ("DSS-1",), "receive")
    assert data.epoch == instant("2024-03-01T00:00:00.5", utc=True)
    assert data.times.tolist() == [0.0, 4.5, 10.0, 19.5]
    assert values(data, "range").tolist() == [0.005 * LIGHT, 0.0051 * LIGHT]
    assert np.degrees(data.values[0, 1:3]).tolist() == pytest.approx([359.5, 45.0], rel=1e-14)
    assert values(data, "range_rate").tolist() == [-1.25, 1.5]
    assert data.weather[:, 0].tolist() == pytest.approx([1000.25, 1002.5, 1005.25, 1010.0], rel=1e-14)
    assert data.weather[0, 1:].tolist() == [280.0, 0.5]
    assert data.remarks == (
        "not used: RECEIVE_FREQ_1",
        "ranges and rates of two-way links are assumed to be for half the round trip",
        "means over 10 s are treated as the range rates at their midpoints",
    )


@BOTH
def test_ranges_of_the_whole_way_are_halved(notation, tmp_path):
    (tmp_path / "a.tdm").write_text(notation())
    (data,) = tdm_data(notation(), "a.tdm", "whole")
    assert values(data, "range")[0] == 0.0025 * LIGHT
    assert values(data, "range_rate").tolist() == [-0.625, 0.75]
    (tmp_path / "a.yaml").write_text("two_way: whole\n")
    (same,) = read_tracking(tmp_path / "a.tdm")
    assert np.array_equal(same.values, data.values, equal_nan=True)


@BOTH
@pytest.mark.parametrize(("clock", "ahead"), [("UTC", 0.0), ("TAI", 37.0), ("GPS", 18.0), ("TT", 69.184)])
def test_clocks_are_turned_into_utc(notation, clock, ahead):
    meta = META.replace("TIME_SYSTEM = UTC", f"TIME_SYSTEM = {clock}")
    (data,) = tdm_data(notation(meta, DATA.replace("Z", "")), "a.tdm")
    shift = instant("2024-03-01T00:00:00.5", utc=True) - data.epoch
    assert shift == round(ahead * 1000) * 10**9


@BOTH
@pytest.mark.parametrize(("reference", "middle"), [("START", 15.0), ("MIDDLE", 10.0), ("END", 5.0)])
def test_an_integrated_doppler_is_of_the_middle_of_its_interval(notation, reference, middle):
    meta = META.replace("INTEGRATION_REF = END", f"INTEGRATION_REF = {reference}")
    (data,) = tdm_data(notation(meta), "a.tdm")
    (at,) = data.times[data.values[:, KINDS.index("range_rate")] == -1.25]
    assert at == middle - 0.5


def test_how_far_a_mean_is_from_the_rate_at_its_middle_is_said():
    meta, t = META.replace("INTEGRATION_REF = END", "INTEGRATION_REF = MIDDLE"), np.arange(0.0, 60.0, 10.0)
    rates = 1e-6 * t**2 + 2e-6 * 100 / 24  # means over 10 s of 1e-6 t^2: its second derivative is 2e-6
    lines = [
        f"DOPPLER_INTEGRATED = 2024-03-01T00:00:{s:02.0f} {v:.12e}\n" for s, v in zip(t, rates, strict=True)
    ]
    (data,) = tdm_data(kvn(meta, "".join(lines)), "a.tdm")
    apart = values(data, "range_rate") - 1e-6 * data.times**2
    assert apart == pytest.approx(np.full(6, 8.333e-6), rel=1e-3)
    assert data.remarks[-1].endswith("at their midpoints, with an error of up to about 8.3 mm/s")


@BOTH
def test_times_of_transmission_and_right_ascensions(notation):
    meta = META.replace("TIMETAG_REF = RECEIVE", "TIMETAG_REF = TRANSMIT")
    meta = meta.replace("ANGLE_TYPE = AZEL", "ANGLE_TYPE = RADEC\nREFERENCE_FRAME = EME2000")
    (data,) = tdm_data(notation(meta), "a.tdm")
    assert data.event == "transmit"
    assert np.degrees(data.values[0, 4:6]).tolist() == pytest.approx([359.5, 45.0], rel=1e-14)
    assert "right ascension and declination of EME2000" in data.remarks


@BOTH
def test_corrections_are_added_unless_they_are_applied(notation):
    more = "CORRECTION_RANGE = 0.001\nCORRECTION_ANGLE_2 = -1\nCORRECTIONS_APPLIED = "
    (data,) = tdm_data(notation(META + more + "NO\n"), "a.tdm")
    assert values(data, "range")[0] == pytest.approx(0.006 * LIGHT, rel=1e-14)
    assert np.degrees(data.values[0, 2]) == pytest.approx(44.0, rel=1e-14)
    (data,) = tdm_data(notation(META + more + "YES\n"), "a.tdm")
    assert values(data, "range")[0] == 0.005 * LIGHT


@BOTH
def test_angles_of_a_one_way_link_are_read_and_its_ranges_are_not(notation):
    meta = META.replace("PATH = 1,2,1", "PATH = 2,1")
    angles = "\n".join(line for line in DATA.splitlines() if line.startswith("ANGLE")) + "\n"
    (data,) = tdm_data(notation(meta, angles), "a.tdm")
    assert (data.kinds, data.stations, data.object) == (("azimuth", "elevation"), ("DSS-1",), "2024-001A")
    with pytest.raises(UserError, match=r"expected a two-way link \(PATH = 1,2,1\)"):
        tdm_data(notation(meta), "a.tdm")


WRONG = {
    ("RANGE_UNITS = s", "RANGE_UNITS = RU"): "column RANGE: expected RANGE_UNITS = km or s; received 'RU'",
    ("RANGE_MODULUS = 0", "RANGE_MODULUS = 32768"): "expected unambiguous ranges (RANGE_MODULUS = 0)",
    ("PATH = 1,2,1", "PATH = 1,2,3"): "column PATH: expected 1,2 or 1,2,1; received 1,2,3",
    ("PATH = 1,2,1", "PATH = 3,2,3"): "column PATH: expected named participants",
    ("MODE = SEQUENTIAL", "MODE = SINGLE_DIFF"): "column MODE: expected SEQUENTIAL; received SINGLE_DIFF",
    ("TIME_SYSTEM = UTC", "TIME_SYSTEM = UT1"): "column TIME_SYSTEM: expected one of UTC, TAI, GPS, TT",
    ("ANGLE_TYPE = AZEL", "ANGLE_TYPE = XEYN"): "expected ANGLE_TYPE = AZEL or RADEC; received 'XEYN'",
    ("ANGLE_TYPE = AZEL", "ANGLE_TYPE = RADEC"): "expected REFERENCE_FRAME = EME2000, ICRF or GCRF",
    ("INTEGRATION_REF = END", "INTEGRATION_REF = LAST"): "expected INTEGRATION_INTERVAL and INTEGRATION_REF",
    ("TIMETAG_REF = RECEIVE", "TIMETAG_REF = X"): "column TIMETAG_REF: expected RECEIVE or TRANSMIT",
    ("DATA_QUALITY = VALIDATED", "RECEIVE_DELAY_1 = 1e-5"): "received RECEIVE_DELAY_1 = 1e-5",
    ("DATA_QUALITY = VALIDATED", "CORRECTION_RANGE = 1"): "expected YES or NO if corrections are given",
    ("DATA_QUALITY = VALIDATED", "MODE = SEQUENTIAL"): "column MODE: expected each keyword once",
}


@BOTH
@pytest.mark.parametrize("change", WRONG, ids=" > ".join)
def test_metadata_that_cannot_be_used_are_refused_by_name(notation, change):
    assert change[0] in META
    with pytest.raises(UserError) as caught:
        tdm_data(notation(META.replace(*change)), "a.tdm")
    assert WRONG[change] in str(caught.value)


BAD = {
    ("0.005\n", "x\n"): "column RANGE: expected a number; received 'x'",
    ("0.005\n", "-1\n"): "column RANGE: expected a number from",
    ("0.005\n", "1e9\n"): "column RANGE: expected a number from",
    (" 45\n", " 145\n"): "column ANGLE_2: expected a number from",
    ("T00:00:10 -1.25", "T00:00:61 -1.25"): "column DOPPLER_INTEGRATED: expected a time of day",
    ("T00:00:20 1010", "T00:00:20 10"): "column PRESSURE: expected a number from 300 to 1200",
    ("RANGE = 2024-061T00:00:10.5Z", "RANGE = 2024-03-01T00:00:00.5"): "expected each keyword once per epoch",
    ("RECEIVE_FREQ_1", "RECEIVED_FREQ_1"): "did you mean 'RECEIVE_FREQ_1'?",
}


@BOTH
@pytest.mark.parametrize("change", BAD, ids=" > ".join)
def test_wrong_data_are_refused_by_their_line_or_left_out(notation, change):
    assert change[0] in DATA
    text = notation(META, DATA.replace(*change, 1))
    with pytest.raises(UserError) as caught:
        tdm_data(text, "a.tdm")
    assert str(caught.value).startswith("a.tdm, row ")
    assert BAD[change] in str(caught.value)
    if "mean" not in BAD[change]:
        faults = []
        (data,) = tdm_data(text, "a.tdm", note=faults.append)
        assert len(faults) == 1
        assert len(data.times) in (3, 4)


def test_the_structure_of_a_message_is_held():
    for old, new, said in (
        (
            "CCSDS_TDM_VERS = 2.0",
            "CCSDS_TDM_VERS = 9.0",
            "expected TDM version 1.0 or 2.0; received '9.0'",
        ),
        ("DATA_STOP\n", "", "expected DATA_STOP at the end of a segment"),
        ("DATA_START\n", "", "expected DATA_START after META_STOP"),
        ("META_STOP\n", "", "row 20: expected KEYWORD = value; received 'DATA_START'"),
        ("ORIGINATOR", "AUTHOR", "expected CREATION_DATE, ORIGINATOR, MESSAGE_ID or META_START"),
    ):
        with pytest.raises(UserError) as caught:
            tdm_data(kvn().replace(old, new), "a.tdm")
        assert said in str(caught.value)
    for old, new, said in (
        (
            "<RANGE>",
            '<RANGE units="km">',
            "column RANGE: expected the units given by RANGE_UNITS; received 'km'",
        ),
        ("<ANGLE_1>", '<ANGLE_1 units="rad">', "column ANGLE_1: expected units deg; received 'rad'"),
        ("<tdm ", '<!DOCTYPE x [<!ENTITY a "b">]><tdm ', "expected no custom entities"),
        ("</tdm>", "", "expected XML"),
        ("<header>", "<oem/><header>", "expected a tracking data message <tdm>; received one with <oem>"),
        ("<EPOCH>2024-03-01T00:00:20</EPOCH><DOPPLER", "<DOPPLER", "expected EPOCH and one value"),
    ):
        with pytest.raises(UserError) as caught:
            tdm_data(xml().replace(old, new), "a.tdm")
        assert said in str(caught.value)


def test_segments_of_a_satellite_are_joined():
    second = kvn(META.replace("DSS-1", "DSS-2")).partition("ORIGINATOR = HERE\n")[2]
    (data,) = tdm_data(kvn() + second, "a.tdm")
    assert data.stations == ("DSS-1", "DSS-2")
    assert np.bincount(data.station).tolist() == [4, 4]
