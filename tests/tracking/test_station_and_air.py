"""Stations and air against the numbers that the IERS publishes with its routines."""

from __future__ import annotations

import numpy as np
import pytest

from ahnn.tracking.atmospheric_delay import (
    Air,
    bending,
    bending_by_recommendation,
    laser_mapping,
    laser_zenith_delay,
    measured_air,
    radio_delay,
    standard_air,
)
from ahnn.tracking.sun_and_moon import MOON_MU, SUN_MU
from ahnn.tracking.tracking_station import cartesian_station, geodetic_station, tidal_displacement


def test_tides_displace_as_dehanttideinel():
    """Test case 1 of the IERS routine DEHANTTIDEINEL, 13 April 2009; the resonance of K1 is left out."""
    station = 1e-3 * np.array([4075578.385, 931852.890, 4801570.154])
    sun = 1e-3 * np.array([[137859926952.015, 54228127881.4350, 23509422341.6960]])
    moon = 1e-3 * np.array([[-179996231.920342, -312468450.131567, -169288918.592160]])
    found = tidal_displacement(station, sun, SUN_MU) + tidal_displacement(station, moon, MOON_MU)
    published = 1e-3 * np.array([0.07700420357108125891, 0.06304056321824967613, 0.05516568152597246810])
    assert np.linalg.norm(found[0] - published) < 8e-6
    assert np.linalg.norm(found[0]) > 1e-4


def test_stations_stand_where_erfa_has_them():
    erfa = pytest.importorskip("erfa")
    found = geodetic_station("Uralla", -30.632947613, 151.5650529068, 1.1632667864364)
    theirs = erfa.gd2gc(1, np.radians(151.5650529068), np.radians(-30.632947613), 1163.2667864364)
    assert found.position == pytest.approx(theirs / 1e3, abs=1e-9)
    again = cartesian_station("Uralla", found.position)
    assert again.height == pytest.approx(found.height, abs=1e-6)
    assert again.latitude == pytest.approx(found.latitude, abs=1e-9)
    assert again.axes @ again.axes.T == pytest.approx(np.eye(3), abs=1e-14)
    assert again.axes[2] @ found.position == pytest.approx(np.linalg.norm(found.position), rel=1e-4)
    assert again.axes[0][2] == 0  # east is level with the equator


def test_laser_zenith_delay_is_that_of_fculzd():
    """Test case of the IERS routine FCULZD_HPA, whose vapour pressure is given itself."""

    class Given(Air):
        vapour = np.array([14.322])

    air = Given(np.array([798.4188]), np.array([300.15]), np.array([0.4]))
    found = laser_zenith_delay(air, np.array([0.532]), np.radians(30.67166667), 2.010344)
    assert found[0] == pytest.approx(1.935225924846803114, rel=3e-6)


def test_laser_mapping_is_that_of_fcul_a():
    """Test case of the IERS routine FCUL_A."""
    found = laser_mapping(np.radians([15.0]), np.array([300.15]), np.radians(30.67166667), 2.075)
    assert found[0] == pytest.approx(3.800243667312344087, rel=1e-12)


def test_radio_delay_is_two_and_a_half_metres_overhead_and_tenfold_at_five_degrees():
    air = standard_air(0.0, 2)
    zenith, low = 1e3 * radio_delay(np.radians([90.0, 5.0]), air, np.radians(45), 0.0)
    dry = 0.0022768 * 1013.25
    assert zenith == pytest.approx(dry + 0.002277 * (1255 / 288.15 + 0.05) * air.vapour[0], rel=2e-3)
    assert 9.5 < low / zenith < 10.8  # the mapping function of Niell has 10.15


def test_missing_weather_is_that_of_the_standard():
    air = measured_air(np.array([[900.0, np.nan, np.nan], [np.nan, 280.0, 0.9]]), 1.0)
    standard = standard_air(1.0, 1)
    assert air.pressure.tolist() == [900.0, standard.pressure[0]]
    assert air.temperature.tolist() == [standard.temperature[0], 280.0]
    assert standard.pressure[0] == pytest.approx(898.7, abs=0.1)  # ICAO at 1 km
    assert standard.temperature[0] == 281.65


def test_air_bends_less_higher_up_and_half_a_degree_at_the_horizon():
    air = standard_air(0.0, 4)
    found = np.degrees(bending(np.radians([0.0, 10.0, 45.0, 89.0]), air))
    assert 0.5 < found[0] < 0.7
    n = 1e-6 * (77.6 * 1013.25 / 288.15 + (3.75e5 / 288.15**2 - 5.6 / 288.15) * air.vapour[0])
    assert found[2] == pytest.approx(np.degrees(n), rel=0.01)
    assert found[1] / found[2] == pytest.approx(1 / np.tan(np.radians(10)), rel=0.07)
    assert found[3] < 0.001
    other = np.degrees(bending_by_recommendation(np.radians([1.0, 5.0, 10.0]), 0.0))
    assert np.degrees(bending(np.radians([1.0, 5.0, 10.0]), standard_air(0.0, 3))) == pytest.approx(
        other, rel=0.15
    )
