"""Units in column names: what they stand for, and which are refused."""

from __future__ import annotations

import math

import pytest
from scipy import constants

from ahnn.data.files.units import BASE, unit


@pytest.mark.parametrize(
    ("text", "size", "dimension"),
    [
        ("km", 1e3, (0, 1, 0, 0)),
        ("km/s", 1e3, (0, 1, -1, 0)),
        ("m s^-1", 1.0, (0, 1, -1, 0)),
        ("m·s⁻¹", 1.0, (0, 1, -1, 0)),
        ("kg km/s", 1e3, (1, 1, -1, 0)),
        ("kg*m**2/s", 1.0, (1, 2, -1, 0)),
        ("g cm²/min", 1e-3 * 1e-4 / 60, (1, 2, -1, 0)),
        ("deg/h", math.pi / 180 / 3600, (0, 0, -1, 1)),
        ("1/s", 1.0, (0, 0, -1, 0)),
        ("m/s/s", 1.0, (0, 1, -2, 0)),
        ("1", 1.0, (0, 0, 0, 0)),
        ("", 1.0, (0, 0, 0, 0)),
    ],
)
def test_what_a_unit_stands_for(text, size, dimension):
    found = unit(text)
    assert found.size == pytest.approx(size, rel=1e-15)
    assert found.dimension == dimension


def test_each_name_has_the_size_that_scipy_gives_it():
    for dimension, sizes in (
        ((1, 0, 0, 0), {"kg": 1.0, "g": constants.gram, "t": constants.metric_ton}),
        ((0, 1, 0, 0), {"m": 1.0, "km": constants.kilo, "cm": constants.centi, "mm": constants.milli}),
        (
            (0, 1, 0, 0),
            {"um": constants.micron, "nm": constants.nano, "au": constants.au, "AU": constants.au},
        ),
        ((0, 0, 1, 0), {"s": 1.0, "ms": constants.milli, "us": constants.micro, "ns": constants.nano}),
        ((0, 0, 1, 0), {"min": constants.minute, "h": constants.hour}),
        ((0, 0, 1, 0), {"d": constants.day, "day": constants.day}),
        ((0, 0, 0, 1), {"rad": 1.0, "deg": constants.degree, "°": constants.degree}),
    ):
        for name, size in sizes.items():
            assert unit(name).size == pytest.approx(size, rel=1e-12)
            assert unit(name).dimension == dimension
            assert unit(f"{name}^-2").size == pytest.approx(size**-2, rel=1e-12)
        assert sizes.keys() <= BASE.keys()


@pytest.mark.parametrize("text", ["furlong", "k m", "m^x", "m^1.5", "m+s", "2 m", "KM"])
def test_what_is_no_unit(text):
    with pytest.raises(ValueError, match="a product of powers of kg"):
        unit(text)
