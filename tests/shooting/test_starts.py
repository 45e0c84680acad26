"""Residuals of many sensors with no more rows than components of a state they see."""

from __future__ import annotations

import torch
from helpers import close, generator

from ahnn.shooting.starts import Linearised

SEGMENTS, TIMES, ROWS, SIZE, PARAMETERS = 3, 5, 9, 6, 4


def many(seen):
    """Return residuals of nine numbers at each time that depend on some components; one time is unseen."""
    draw = generator(3)
    of_state = torch.randn(SEGMENTS, TIMES, ROWS, SIZE, generator=draw, dtype=torch.float64)
    of_state[..., seen:] = 0
    of_state[0, 2] = 0
    moved = torch.randn(SEGMENTS, TIMES, SIZE, SIZE, generator=draw, dtype=torch.float64)
    residuals = torch.randn(SEGMENTS, TIMES, ROWS, generator=draw, dtype=torch.float64)
    residuals[0, 2] = 0
    return Linearised(moved[:, 1:], residuals, of_state, of_state @ moved)


def equations(linear):
    """Return the matrix and the right side of the normal equations in starts and four parameters."""
    draw = generator(4)
    moved = torch.randn(SEGMENTS, TIMES, SIZE, PARAMETERS, generator=draw, dtype=torch.float64)
    rows = torch.cat((linear.of_start, linear.of_state @ moved), dim=-1).flatten(1, 2)
    return rows.mT @ rows, rows.mT @ linear.residuals.flatten(1).unsqueeze(-1)


def test_condensed_residuals_have_the_same_normal_equations_in_fewer_rows():
    plain = many(seen=3)
    few = plain.condensed()
    assert few.residuals.shape == (SEGMENTS, TIMES, 3)
    for mine, exact in zip(equations(few), equations(plain), strict=True):
        close(mine, exact, 1e-13)


def test_residuals_that_see_as_many_components_as_they_have_rows_stay():
    plain = many(seen=6)._replace(of_state=many(seen=6).of_state[..., :6, :])
    assert plain.condensed() is plain
