"""A gap is cut into the fewest equal steps that are not too long, rounding apart."""

from __future__ import annotations

import math

import torch
from hypothesis import given
from hypothesis import strategies as st

from ahnn.substeps import substeps, substeps_of_each

LENGTHS = st.floats(1e-3, 1e3)


@given(gap=LENGTHS, longest=LENGTHS)
def test_steps_are_the_fewest_that_are_short_enough(gap, longest):
    count = substeps(gap, longest)
    assert gap / count <= longest * (1 + 1e-9)
    assert count == 1 or gap / (count - 1) > longest
    assert substeps_of_each(torch.tensor([gap], dtype=torch.float64), longest).tolist() == [count]


@given(count=st.integers(1, 10_000), longest=LENGTHS)
def test_rounding_adds_no_step(count, longest):
    assert substeps(math.nextafter(count * longest, math.inf), longest) == count


def test_the_longest_member_counts_and_a_trajectory_that_has_ended_does_not():
    gaps = torch.tensor([0.5, -2.0, math.nan])
    assert substeps(gaps, 1.0) == 2
    assert substeps(gaps[2:], 1.0) == 1
    assert substeps(gaps, math.inf) == 1
