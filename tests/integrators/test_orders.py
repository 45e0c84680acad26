"""The observed order of every method is its nominal one, against the exact solution of Kepler's problem."""

from __future__ import annotations

import math

import pytest
import torch
from helpers import SYSTEMS

from ahnn.integrators import INTEGRATORS

KEPLER = SYSTEMS["kepler"]
E = 0.3

# Time and coarse number of steps of each method: small enough to be asymptotic, errors far above round-off.
PROBLEMS = {
    "euler": (2.0, 1024),
    "midpoint": (2.0, 256),
    "rk4": (2.0, 128),
    "dopri5": (5.0, 512),
    "dopri8": (2.0, 16),
    "gl4": (2.0, 32),
    "leapfrog": (2.0, 64),
    "yoshida4": (2.0, 64),
    "yoshida6": (2.0, 64),
    "yoshida8": (2.0, 32),
    "kahan_li6": (2.0, 32),
    "kahan_li8": (2.0, 8),
}


def exact(t):
    """State (1, 4) at time t after periapsis, mu = a = 1, by Newton's method on Kepler's equation."""
    anomaly = t
    for _ in range(50):
        anomaly -= (anomaly - E * math.sin(anomaly) - t) / (1 - E * math.cos(anomaly))
    b, rate = math.sqrt(1 - E * E), 1 / (1 - E * math.cos(anomaly))
    q = (math.cos(anomaly) - E, b * math.sin(anomaly))
    p = (-math.sin(anomaly) * rate, b * math.cos(anomaly) * rate)
    return torch.tensor([[*q, *p]], dtype=torch.float64)


def error(method, time, steps):
    x = exact(0.0)
    for _ in range(steps):
        x = method.step(KEPLER, x, time / steps)
    return float((x - exact(time)).abs().max())


def test_every_method_has_a_problem():
    assert set(PROBLEMS) == set(INTEGRATORS)


@pytest.mark.parametrize("name", PROBLEMS)
def test_observed_order_is_the_nominal_one(name):
    method = INTEGRATORS[name]
    time, steps = PROBLEMS[name]
    coarse, fine = error(method, time, steps), error(method, time, 2 * steps)
    assert fine > 5e-14, "too close to round-off to tell"
    assert abs(math.log2(coarse / fine) - method.order) < 0.1
