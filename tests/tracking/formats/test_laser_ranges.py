"""Laser ranging data (CRD): ranges, days, weather and wavelengths; what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from made_formats import CRD, CRD2, REAL

from ahnn.data.files import instant
from ahnn.data.files.epochs import SECOND, spelled
from ahnn.errors import UserError
from ahnn.tracking.formats.crd import crd_data
from ahnn.tracking.formats.crd_session import WeatherRecord, moment_near, weather_at
from ahnn.tracking.formats.tracking_files import read_tracking

HALF = 149896.229  # km of half a second of light


def test_passes_and_stations_of_a_satellite_are_one():
    (data,) = crd_data(CRD, "a.npt")
    assert (data.object, data.stations, data.event) == ("lageos2", ("7090", "7825"), "transmit")
    assert data.kinds == ("range",)
    assert data.station.tolist() == [0, 0, 0, 0, 0, 1, 1]
    assert np.allclose(data.values[[0, 3, 6], 0], HALF * np.array([0.04, 0.0381, 0.0405]), rtol=1e-14, atol=0)
    assert data.wavelength.tolist() == [0.532] * 5 + [0.5321] * 2
    assert "instrument descriptions" in data.remarks[0]


def test_seconds_of_the_day_begin_again_or_go_on_after_midnight():
    (data,) = crd_data(CRD, "a.npt")
    epochs = [spelled(data.epoch + round(time * SECOND), utc=True) for time in data.times]
    assert [text[:19] for text in epochs[2:]] == [
        "2016-02-13T23:58:20",
        "2016-02-14T00:02:40",
        "2016-02-14T00:11:00",
        "2016-02-14T01:00:00",
        "2016-02-14T01:06:40",
    ]
    assert data.epoch == instant("2016-02-13T23:41:00.0005626", utc=True)
    assert data.times[1] == pytest.approx(120.000004799997, rel=1e-14)


def test_no_picosecond_of_an_epoch_is_lost_and_a_leap_second_is_counted():
    evening = instant("2016-12-31T23:50:00", utc=True)
    assert moment_near(evening, "85800.123456789012") == evening + 123456789012
    assert moment_near(evening, "8.58e4") == evening
    after = moment_near(evening, "30.5")
    assert after == instant("2017-01-01T00:00:30.5", utc=True) == evening + 631 * SECOND + SECOND // 2


def test_weather_is_linear_between_records_and_that_of_the_nearest_outside():
    (data,) = crd_data(CRD, "a.npt")
    share = np.array([0.0, 0.0667, 0.5778, 0.7222, 1.0])
    assert np.allclose(data.weather[:5, 0], 983.7 - 2 * share, atol=1e-3)
    assert np.allclose(data.weather[4], [981.7, 300.4, 0.34], rtol=1e-12)
    assert np.isnan(data.weather[5:]).all()
    record = WeatherRecord(0, (900.0, 280.0, 0.5))
    assert weather_at([record], [5 * SECOND, -(10**20)]) == [record.values] * 2


def test_version_2_with_two_colours():
    (data,) = crd_data(CRD2, "a.np2")
    assert (data.object, data.stations) == ("LAGEOS1", ("7810",))
    assert data.wavelength.tolist() == [0.846, 0.423, 0.846]
    assert "station records" in data.remarks[0]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("h1 CRD  1", "h1 CRD  3", "row 1, column record H1: expected CRD version 1 or 2"),
        ("h4  1 2016", "h4  0 2016", "expected normal points (data type 1); received full-rate data"),
        (
            " 0  0 0 0 0 1 0 2 0\nc0",
            " 0  0 1 0 0 1 0 2 0\nc0",
            "expected ranges not yet corrected for refraction",
        ),
        (
            " 0  0 0 0 0 1 0 2 0\nc0",
            " 0  0 0 0 0 0 0 2 0\nc0",
            "expected ranges corrected for the station delay",
        ),
        (" 0  0 0 0 0 1 0 2 0\nc0", " 0  0 0 0 0 1 0 1 0\nc0", "expected two-way ranges"),
        ("22195 0 1", "22195 1 3", "expected a satellite with reflectors; received a transponder"),
        ("7090  5", "pad  5", "row 2, column record H2: expected name, pad, system, occupancy and clock"),
        (
            "85260.000562600000     0.04",
            "85260.000562600000     x.04",
            "row 10, column record 11: expected a",
        ),
        ("0.040000000000", "4000.0", "expected a number from 0.0001 to 30; received '4000.0'"),
        ("std 2  120.0     94", "std 5  120.0     94", "expected epoch event 0, 1 or 2 for a two-way range"),
        ("85260.000562600000", "45260.0005", "expected a time within its session (H4)"),
        ("983.70 301.40", "983.70 1.40", "expected a number from 180 to 340"),
        ("c0 0  532.000", "c0 0  5320000", "expected a number from 200 to 12000"),
        ("h8\n", "", "expected record H8 at the end of each session; received another file"),
        ("h2 YARL", "x2 YARL", "row 2, column record X2: expected a CRD record"),
        ("2016  2 13 23 40", "2016  2 30 23 40", "expected year, month and day; received '2016 2 30'"),
        (
            "C0 0 532.10 IDAA IDAB IDAJ IDAV",
            "00",
            "expected record C0 for its configuration; received 'IDAA'",
        ),
    ],
)
def test_what_is_wrong_is_refused_by_its_line(old, new, said):
    assert old in CRD
    with pytest.raises(UserError) as caught:
        crd_data(CRD.replace(old, new, 1), "a.npt")
    assert str(caught.value).startswith("a.npt")
    assert said in str(caught.value)


def test_a_damaged_point_is_noted_and_the_others_are_read():
    faults = []
    (data,) = crd_data(CRD.replace("0.040000000000", "4000.0", 1), "a.npt", faults.append)
    assert len(data.times) == 6
    assert [fault.place.row for fault in faults] == [10]
    (cut,) = crd_data(CRD[: CRD.index("H8\n")], "a.npt", faults.append)
    assert len(cut.times) == 7
    assert "no record H9 at the end" in cut.remarks[1]


@pytest.mark.skipif(not REAL.is_dir(), reason="no real files beside the checkout")
def test_real_normal_points():
    (data,) = read_tracking(REAL / "lageos2" / "lageos2_20160214.npt")
    assert np.bincount(data.station).tolist() == [17, 37, 27, 14]
    assert data.stations == ("7825", "7090", "7119", "7941")
    assert ((data.values[:, 0] > 5600) & (data.values[:, 0] < 8500)).all()
    assert np.isfinite(data.weather).all()
    assert (np.diff(data.times) > 0).all()
