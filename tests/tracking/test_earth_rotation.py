"""The turn of the Earth against erfa's own way and astropy's, and the days that must be known."""

from __future__ import annotations

import numpy as np
import pytest
from earth import DAYS, EPOCH, LAST, orientation, rotation

from ahnn.data.files.frames import terrestrial
from ahnn.errors import UserError
from ahnn.tracking.earth_rotation import EarthRotation
from ahnn.tracking.formats.finals import finals_orientation, installed_orientation
from ahnn.tracking.sun_and_moon import sun_and_moon

erfa = pytest.importorskip("erfa")
SECOND = np.pi / 648000
TIMES = np.array([-40000.0, 0.0, 12345.6, 80000.0])


def test_matrices_are_those_of_erfa_with_ut1_and_the_pole():
    tt = terrestrial(EPOCH, TIMES, "UTC")
    utc = erfa.taiutc(*erfa.tttai(*tt))
    ut1 = erfa.utcut1(*utc, 0.017)
    theirs = erfa.c2t06a(*tt, *ut1, 0.02 * SECOND, 0.39 * SECOND)
    assert np.abs(rotation().matrices(TIMES) - theirs).max() < 2e-11


def test_offsets_of_the_celestial_pole_turn_by_their_own_size():
    both = rotation(offsets=0.1).matrices(TIMES), rotation().matrices(TIMES)
    angle = np.arccos((np.einsum("tij,tij->t", *both) - 1) / 2)
    assert angle == pytest.approx(0.1 * 2**0.5 * SECOND, rel=1e-3)


def test_matrices_are_those_of_astropy_with_its_own_days():
    iers = pytest.importorskip("astropy.utils.iers")
    units, coordinates = pytest.importorskip("astropy.units"), pytest.importorskip("astropy.coordinates")
    clock = pytest.importorskip("astropy.time")
    table = iers.IERS_A.open(pytest.importorskip("astropy_iers_data").IERS_A_FILE)
    ours = EarthRotation(EPOCH, 0.0, LAST, installed_orientation())
    times = clock.Time("2016-02-13T16:00:00", scale="utc") + clock.TimeDelta(TIMES[1:], format="sec")
    place = np.array([42164.0, 3000.0, -900.0])
    seen = coordinates.CartesianRepresentation(np.tile(place[:, None], 3) * units.km)
    with iers.earth_orientation_table.set(table):
        there = coordinates.GCRS(seen, obstime=times).transform_to(coordinates.ITRS(obstime=times))
    theirs = there.cartesian.xyz.to_value(units.km).T
    # astropy leaves out dX and dY, and is linear between days: 0.3 mas and 0.05 ms.
    assert np.abs(ours.matrices(TIMES[1:]) @ place - theirs).max() < 2e-4


def test_days_that_do_not_reach_are_refused():
    with pytest.raises(
        UserError, match=r"orientation: expected four days that enclose MJD 57431\.7 to 57464"
    ):
        EarthRotation(EPOCH, 0.0, 32.4 * LAST, orientation())
    few = type(orientation())(*(part[:3] for part in orientation()))
    with pytest.raises(UserError, match="received 3 days, 57428 to 57430"):
        EarthRotation(EPOCH, 0.0, 1.0, few)
    assert len(DAYS) > 4


def test_leap_seconds_between_days_are_no_jump_of_the_earth():
    from ahnn.data.files import epochs

    epoch = epochs.instant("2016-12-31T23:59:50", utc=True)
    days = np.arange(57751.0, 57757.0)
    drift = np.where(days < 57754, -0.4, 0.6)  # 1 January 2017 is 57754
    rows = type(orientation())(days, 0 * days, 0 * days, drift, np.zeros((6, 2)), days > 0)
    matrices = EarthRotation(epoch, 0.0, 100.0, rows).matrices(np.array([5.0, 20.0]))
    turn = matrices[1] @ matrices[0].T
    assert np.arctan2(turn[0, 1], turn[0, 0]) == pytest.approx(15 * 7.292115e-5, rel=1e-6)


def test_a_line_of_finals_is_read_by_its_columns():
    line = list(" " * 188)
    for first, text in (
        (7, "57432.00"),
        (18, " 0.020100"),
        (37, " 0.390200"),
        (57, "I"),
        (58, " 0.0173000"),
        (97, "    0.150"),
        (116, "   -0.060"),
    ):
        line[first : first + len(text)] = text
    found = finals_orientation("".join(line) + "\n" + " " * 188, "finals")
    assert (found.mjd[0], found.x[0], found.y[0], found.ut1_utc[0]) == (57432.0, 0.0201, 0.3902, 0.0173)
    assert found.pole[0] == pytest.approx([0.00015, -0.00006])
    with pytest.raises(UserError, match="days with UT1-UTC"):
        finals_orientation(" " * 188, "finals")


def test_sun_and_moon_are_where_erfa_has_them():
    pytest.importorskip("de421")
    found = sun_and_moon(EPOCH, 0.0, LAST)
    tt = terrestrial(EPOCH, TIMES[1:], "UTC")
    moon = erfa.moon98(*tt)["p"] * 149597870.7
    assert np.abs(found.moon(TIMES[1:]) - moon).max() < 100.0  # a series of a few km to tens of km
    helio, _ = erfa.epv00(*tt)
    assert np.abs(found.sun(TIMES[1:]) + helio["p"] * 149597870.7).max() < 2000.0
