"""Numbers in sentences are written as a reader would write them."""

from __future__ import annotations

import pytest

from ahnn.numbers import in_percent


@pytest.mark.parametrize(
    ("fraction", "text"),
    [
        (1.0, "100"),
        (0.9951, "100"),
        (0.994, "99"),
        (0.0995, "10"),
        (0.0123, "1.2"),
        (0.001, "0.1"),
        (0.0, "0"),
    ],
)
def test_a_fraction_in_percent_has_two_digits_and_no_exponent(fraction, text):
    assert in_percent(fraction) == f"{text} %"
    assert in_percent(1e-9) == "less than 0.01 %"
