"""Epochs against other calendars: leap seconds of SOFA, days of Python, and the years of element sets."""

from __future__ import annotations

import datetime

import pytest

from ahnn.data.files import elements, instant
from ahnn.data.files.epochs import DAY, FIRST, LEAPS, SECOND, leaps, spelled
from ahnn.data.files.table import Fault, Place


def test_leap_seconds_are_those_of_sofa():
    erfa = pytest.importorskip("erfa")
    table = [(int(year), int(month), float(ahead)) for year, month, ahead in erfa.leap_seconds.get()]
    whole = {datetime.date(y, m, 1).toordinal() - FIRST: ahead for y, m, ahead in table if y >= 1972}
    assert sorted(LEAPS) == sorted(whole)[1:]  # at the first of 1972 UTC begins, 10 s behind TAI
    for day, ahead in whole.items():
        assert leaps(day) + 10 == ahead
        assert leaps(day - 1) + 10 == (ahead - 1 if leaps(day) else 10)


def test_an_epoch_counts_from_the_first_day_of_2000():
    for text, seconds in (
        ("2000-01-01T00:00:00", 0),
        ("2000-01-01T01:02:03", 3723),
        ("1999-12-31T23:59:59.25", -0.75),
        ("2000-03-01T00:00:00", 60 * DAY),
        ("2000-061T00:00:00Z", 60 * DAY),
        ("2000-366T12:00:00", 365.5 * DAY),
        ("2001-001T00:00:00", 366 * DAY),
    ):
        assert instant(text, utc=False) == int(seconds * SECOND)


def test_twelve_decimals_count_and_what_is_behind_them_does_not():
    assert instant("2000-01-01T00:00:00.000000000001", utc=False) == 1
    assert instant("2000-01-01T00:00:00.1234567890129", utc=False) == 123456789012
    assert spelled(123456789012, utc=False) == "2000-01-01T00:00:00.123456789012"
    assert spelled(SECOND // 2, utc=False) == "2000-01-01T00:00:00.500"
    assert spelled(0, utc=False) == "2000-01-01T00:00:00.000"


@pytest.mark.parametrize("clock", ["24:00:00", "23:60:00", "23:59:60", "12:00:60", "23:58:60"])
def test_a_time_of_day_ends_before_the_next_day(clock):
    for day, utc in (("2016-12-31", False), ("2016-12-30", True)):
        with pytest.raises(ValueError, match="a time of day"):
            instant(f"{day}T{clock}", utc=utc)
    assert instant("2016-12-31T23:59:60", utc=True) + SECOND == instant("2017-01-01T00:00:00", utc=True)
    with pytest.raises(ValueError, match="a time of day"):
        instant("2016-12-31T23:59:61", utc=True)


def test_offsets_are_less_than_sixteen_hours():
    noon = instant("2024-03-02T03:59:00", utc=True)
    assert instant("2024-03-01T12:00:00-15:59", utc=True) == noon
    for offset in ("+16:00", "-16:00", "+15:60"):
        with pytest.raises(ValueError, match="a UTC offset"):
            instant(f"2024-03-01T12:00:00{offset}", utc=True)


@pytest.mark.parametrize("day", ["2023-366", "2023-000", "2023-02-29", "2023-13-01"])
def test_a_day_is_one_of_its_year(day):
    with pytest.raises(ValueError, match="a calendar date"):
        instant(f"{day}T00:00:00", utc=False)


def test_seconds_around_a_leap_second_are_spelled_in_their_order():
    for day in LEAPS:
        date = datetime.date.fromordinal(FIRST + day)
        before = date - datetime.timedelta(days=1)
        expected = [f"{before}T23:59:{second}.000" for second in (58, 59, 60)]
        expected += [f"{date}T00:00:{second:02}.000" for second in range(40)]
        begin = instant(f"{before}T23:59:58", utc=True)
        assert [spelled(begin + k * SECOND, utc=True) for k in range(43)] == expected


def test_the_epoch_of_an_element_set_has_two_digits_of_its_year():
    for text, expected in (
        ("57001.00000000", "1957-01-01T00:00:00"),
        ("56366.50000000", "2056-12-31T12:00:00"),
        ("99365.99999999", "1999-12-31T23:59:59.999136"),
        ("00179.78495062", "2000-06-27T18:50:19.733568"),
        ("17001.00000000", "2017-01-01T00:00:00"),
        ("17001.5       ", "2017-01-01T12:00:00"),
    ):
        first = f"1 00005U 58002B   {text}  .00000023"
        found = elements.epoch(elements.ElementSets(Place("a.tle", 1), (first, "")))
        assert found == instant(expected, utc=True)


def test_an_epoch_of_no_numbers_is_a_fault_of_its_column():
    with pytest.raises(Fault, match=r"a.tle, row 3, column epoch: expected year and day"):
        elements.epoch(elements.ElementSets(Place("a.tle", 3), ("1 00005U 58002B   00x79.78495062", "")))
