"""Frames, centres, clocks and epochs: what a text says, what fits, and what is refused."""

from __future__ import annotations

import math

import pytest

from ahnn.data.files import instant
from ahnn.data.files.epochs import SECOND
from ahnn.data.reference import Reference
from ahnn.errors import UserError
from ahnn.measurements.ground_station import EARTH_RATE

NOON = instant("2024-03-01T12:00:00", utc=True)
TEXT = "EME2000, EARTH, UTC, from 2024-03-01T12:00:00.000"
WHOLE = Reference("EME2000", "EARTH", "UTC", NOON)


def test_the_earth_turns_as_mean_sidereal_time_less_precession():
    """Meeus, Astronomical Algorithms, example 12.a: 13 h 10 min 46.3668 s at 0 h on 10 April 1987."""
    sidereal = (13 + 10 / 60 + 46.3668 / 3600) * math.pi / 12
    century = -0.127296372348  # from J2000.0
    precession = (0.014506 + 4612.156534 * century + 1.3915817 * century**2) / 3600 * math.pi / 180
    epoch = instant("1987-04-10T00:00:00", utc=True)
    angle = Reference(clock="UTC", epoch=epoch).earth_angle()
    assert angle == pytest.approx(sidereal - precession, abs=2e-6)


def test_the_earth_turns_by_its_rotation_angle():
    """20 days later, a station is where a reference of that moment places it: to 0.1 mm."""
    first, second = (instant(f"2024-03-{day:02}T06:00:00", utc=True) for day in (1, 21))
    angles = [Reference(clock="UTC", epoch=epoch).earth_angle() for epoch in (first, second)]
    turned = angles[0] + EARTH_RATE * 20 * 86400.0
    assert math.remainder(turned - angles[1], math.tau) == pytest.approx(0.0, abs=1e-4 / 6378137)


@pytest.mark.parametrize(
    ("text", "reference"),
    [
        (TEXT, WHOLE),
        ("EME2000, EARTH, UTC", WHOLE._replace(epoch=None)),
        ("EME2000, EARTH", Reference("EME2000", "EARTH")),
        ("EME2000", Reference("EME2000")),
        ("", Reference()),
        ("EME2000, ?, UTC, from 2024-03-01T12:00:00.000", WHOLE._replace(center="")),
    ],
)
def test_a_text_says_what_a_reference_is_and_the_other_way_round(text, reference):
    assert Reference.of(text) == reference
    assert Reference.of(str(reference)) == reference


@pytest.mark.parametrize(
    ("reference", "said"),
    [
        (WHOLE, "EME2000, EARTH, UTC, time zero 2024-03-01T12:00:00.000"),
        (Reference("GCRF", clock="TAI"), "GCRF, TAI, centre not stated (frame=)"),
        (Reference(clock="UTC"), "UTC, frame and centre not stated (frame=)"),
        (Reference(), ""),
    ],
)
def test_a_reader_learns_what_a_reference_does_not_state(reference, said):
    assert reference.described() == said


def test_an_epoch_is_of_the_clock_that_is_named_or_of_utc():
    assert Reference.of("from 2024-03-01T12:00:00") == Reference(clock="UTC", epoch=NOON)
    tai = instant("2024-03-01T12:00:00", utc=False)
    assert Reference.of("from 2024-03-01T12:00:00 TAI") == Reference(clock="TAI", epoch=tai)
    assert Reference.of("GCRF, EARTH, TAI, from 2024-03-01T12:00:00").epoch == tai
    assert Reference.of("from noon") == Reference(clock="UTC")
    assert Reference(clock="TAI").since("2024-03-01T12:00:00").epoch == tai
    assert Reference().since("2024-03-01T12:00:00") == Reference(clock="UTC", epoch=NOON)
    assert WHOLE.since(None) == WHOLE
    with pytest.raises(UserError, match=r"epoch: expected .*; received 'noon'"):
        WHOLE.since("noon")


def test_an_epoch_turns_between_clocks_as_these_differ():
    """In 2024 UTC was 37 s behind TAI, and GPS 19 s."""
    tai = WHOLE.on("TAI")
    assert str(tai) == "EME2000, EARTH, TAI, from 2024-03-01T12:00:37.000"
    assert str(tai.on("GPS")) == "EME2000, EARTH, GPS, from 2024-03-01T12:00:18.000"
    assert tai.on("UTC") == WHOLE
    assert str(WHOLE.on("TT")) == "EME2000, EARTH, TT, from 2024-03-01T12:01:09.184"
    assert WHOLE.on("UTC") == WHOLE.on("") == WHOLE
    assert Reference("GCRF").on("UT1") == Reference("GCRF", clock="UT1")
    for ours, theirs in (("UTC", "UT1"), ("UT1", "UTC")):
        with pytest.raises(
            UserError, match=f"time system: expected {ours}, or both of UTC.*received {theirs}"
        ):
            WHOLE._replace(clock=ours).on(theirs)


def test_what_one_reference_does_not_say_another_says():
    assert Reference("GCRF", clock="TAI").filled(WHOLE) == Reference(
        "GCRF", "EARTH", "TAI", WHOLE.on("TAI").epoch
    )
    later = Reference(epoch=NOON + SECOND)
    assert later.filled(WHOLE).epoch == NOON + SECOND
    assert WHOLE.filled(later) == WHOLE


def test_a_user_names_what_a_run_does_not_say_and_nothing_else():
    assert WHOLE.chosen(Reference(center="Earth")) == WHOLE._replace(center="Earth")
    assert Reference("GCRF").chosen(Reference(center="MARS")) == Reference("GCRF", "MARS")
    for keys, said in (
        ({"frame": "GCRF"}, "frame: expected EME2000"),
        ({"center": "MARS"}, "center: .*EARTH"),
    ):
        with pytest.raises(UserError, match=said):
            WHOLE.chosen(Reference(**keys))


@pytest.mark.parametrize(
    ("given", "ours", "turned"),
    [
        (("EME2000", "EARTH"), ("EME2000", "EARTH"), None),
        (("J2000", "EARTH"), ("EME2000", ""), None),
        (("", ""), ("EME2000", "MARS"), None),
        (("", "MARS"), ("EME2000", "MARS"), None),
        (("EME2000", ""), ("", ""), None),
        (("TNW", ""), ("", ""), None),
        (("EME2000", "EARTH"), ("GCRF", ""), "GCRF"),
        (("ITRF2014", "EARTH"), ("EME2000", "EARTH"), "EME2000"),
    ],
)
def test_numbers_are_turned_into_the_frame_of_a_model(given, ours, turned):
    assert Reference(*given).turn(Reference(*ours), "start") == turned


@pytest.mark.parametrize(
    ("given", "ours", "said"),
    [
        (("", "MARS"), ("", "EARTH"), "who: expected centre EARTH.*received MARS. Convert it"),
        (("", "MARS"), ("", ""), "expected centre EARTH.*received MARS. Set frame= or center= if MARS"),
        (("", "EARTH"), ("", "MARS"), "expected centre MARS.*received EARTH. Convert it"),
        (("EME2000", ""), ("TNW", ""), "expected frame TNW.*received EME2000. Convert it"),
        (("TNW", ""), ("GCRF", ""), "expected frame GCRF.*received TNW. Convert it"),
        (("ITRF2014", ""), ("", ""), "expected an inertial frame; received ITRF2014. Set frame= to"),
    ],
)
def test_a_frame_or_a_centre_that_does_not_fit_is_refused(given, ours, said):
    with pytest.raises(UserError, match=said):
        Reference(*given).turn(Reference(*ours), "who")
