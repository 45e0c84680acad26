"""Numbers as text read back as the same float64, and are as short as those of Python."""

from __future__ import annotations

import math
import struct

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ahnn.assimilation import decimal_rows as rows


@settings(max_examples=300)
@given(st.lists(st.floats(allow_nan=False), min_size=1, max_size=8))
def test_any_number_reads_back(numbers):
    (text,) = rows.decimal_rows(np.array([numbers]))
    assert [float(cell) for cell in text.split(",")] == numbers


def test_they_are_those_of_python():
    draw = np.random.default_rng(0)
    bits = draw.integers(0x3C00000000000000, 0x4400000000000000, 20_000)  # 1e-19 to 1e19
    numbers = [struct.unpack("<d", struct.pack("<Q", int(b)))[0] for b in bits]
    numbers += (
        [k / 1000 for k in range(-2000, 2000)]
        + [10.0**k for k in range(-30, 40)]
        + draw.normal(size=5000).tolist()
    )
    numbers += [2.0**k for k in range(-100, 120)] + [0.1 + 0.2, 1e22, 123456789012345678.0, 5e-324, -0.0]
    texts = rows.decimal_rows(np.array(numbers)[:, None])
    assert [float(text) for text in texts] == numbers
    assert (
        sum(text != repr(x) for text, x in zip(texts, numbers, strict=True)) < len(numbers) / 50
    )  # ties, where two are as near


def test_what_is_missing_is_empty_and_without_a_compiler_all_is_the_same(monkeypatch):
    values = np.array([[1.5, math.nan, -2e-7], [math.nan, 3.0, 60.0]])
    expected = ["1.5,,-2e-07", ",3.0,60.0"]
    assert rows.decimal_rows(values) == expected
    monkeypatch.setattr(rows, "library", lambda: None)
    assert rows.decimal_rows(values) == expected
