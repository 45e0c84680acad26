"""Test functions over many samples are (1 - u^2)^8 and its derivatives, times the weights of a sum."""

from __future__ import annotations

import pytest
import torch
from helpers import close
from numpy.polynomial import Polynomial

from ahnn.training.spans import bumps, integrated

DOUBLE = {"dtype": torch.float64}
STEP = 0.2


@pytest.mark.parametrize(("order", "sign"), [(1, 1), (2, -1)])
def test_test_functions_are_bumps_and_their_derivatives(order, sign):
    times = 3.0 + STEP * torch.arange(241, **DOUBLE).unsqueeze(0)
    tests = bumps(times, torch.ones(1, 241, dtype=torch.bool), 60, order)
    assert tests.stride == 20
    assert tests.on_field.shape == (1, 7, 121)
    bump, u = Polynomial([1, 0, -1]) ** 8, torch.linspace(-1, 1, 121, **DOUBLE)
    derivative = sign * bump.deriv(order)(u.numpy()) / (60 * STEP) ** order
    for span in range(7):
        close(tests.on_field[0, span], STEP * torch.from_numpy(bump(u.numpy())), 1e-12)
        close(tests.on_data[0, span], STEP * torch.from_numpy(derivative), 1e-6)


def test_spans_follow_each_other_and_know_what_is_missing():
    present = torch.ones(1, 241, dtype=torch.bool)
    present[0, 45] = False
    tests = bumps(STEP * torch.arange(241, **DOUBLE).unsqueeze(0), present, 60)
    assert tests.there.tolist() == [[False, False, False, True, True, True, True]]
    ramp = torch.arange(241, **DOUBLE).view(1, -1, 1)
    centres = integrated(tests.on_field, tests.stride, ramp) / tests.on_field.sum(-1, keepdim=True)
    close(centres.flatten(), 60.0 + 20 * torch.arange(7, **DOUBLE), 1e-12)
