"""Directions of parameters for a filter: against a consider filter of states and parameters together."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator
from oscillators import DOUBLE, Swing
from torch.func import functional_call, jacrev, vmap

from ahnn.estimation.scenario import Setting
from ahnn.measurements import Position
from ahnn_plugins.ukf.directions import filtered_directions

FACTOR = torch.tensor([[0.05, 0.0], [-0.02, 0.04]], **DOUBLE)
DT, STEPS = 0.05, 100
START = torch.randn(5, 2, generator=generator(3), **DOUBLE)


def setting(updates=tuple(range(10, STEPS, 10)), measurement=None, sd=0.01):
    sds = torch.tensor([0.05, 0.02], **DOUBLE)
    return Setting(measurement or Position(1), torch.tensor([sd], **DOUBLE), sds, updates)


def directions(most, factor=FACTOR, start=START, asked=None):
    return filtered_directions(Swing(), factor, start, DT, STEPS, asked or setting(), most).directions


class _Step(Swing):
    def forward(self, x):
        return x + self.increment(x, torch.tensor(DT, **DOUBLE))


def joint(asked):
    """P_eta,x P_x^-1 P_x,eta of paths, times, (M, 2, 2), by the covariance of (q, p, eta) in one matrix."""

    def step(z):
        own = {"field.stiffness": torch.tensor([2.0, 0.5], **DOUBLE) + FACTOR @ z[2:]}
        return torch.cat((functional_call(_Step(), own, (z[:2],)), z[2:]))

    z, grams = torch.cat((START, torch.zeros(5, 2, **DOUBLE)), 1), []
    both = torch.diag(torch.cat((asked.start_sd**2, torch.ones(2, **DOUBLE)))).expand(5, 4, 4)
    rows = torch.tensor([[1.0, 0.0, 0.0, 0.0]], **DOUBLE)
    for k in range(1, STEPS + 1):
        moved = vmap(jacrev(step))(z)
        z, both = vmap(step)(z), moved @ both @ moved.mT
        grams.append(both[:, 2:, :2] @ torch.linalg.inv(both[:, :2, :2]) @ both[:, :2, 2:])
        if k in asked.updates:
            seen = both @ rows.mT
            gain = seen / (rows @ seen + asked.measurement_noise)
            gain[:, 2:] = 0.0  # parameters are considered, not learned
            left = torch.eye(4, **DOUBLE) - gain @ rows
            both = left @ both @ left.mT + gain @ asked.measurement_noise @ gain.mT
    return torch.cat(grams)


@pytest.mark.parametrize("sd", [0.003, 1.0])
def test_directions_are_those_that_a_consider_filter_does_not_tell_from_measurements(sd):
    asked = setting(sd=sd)
    with torch.enable_grad():
        sizes, axes = torch.linalg.eigh(joint(asked).sum(0))
    assert float(sizes[0]) < 0.5 * float(sizes[1])  # there is a first one
    with torch.no_grad():
        found = directions(2, asked=asked)
        expected = FACTOR @ axes.flip(1)
        close(found * (found * expected).sum(0).sign(), expected, 0.01)
        assert bool((found.amax(0) == found.abs().amax(0)).all())  # a sign of its own, for saved filters


def test_what_is_left_out_adds_to_the_nees_what_it_says():
    with torch.enable_grad():
        grams = joint(setting())
        second = torch.linalg.eigh(grams.sum(0)).eigenvectors[:, 0]
    with torch.no_grad():
        chosen = filtered_directions(Swing(), FACTOR, START, DT, STEPS, setting(), 1)
        expected = float((second @ grams @ second).max())
        assert chosen.left_out == pytest.approx(expected, rel=0.02)
        small = torch.cat((FACTOR[:, :1], 1e-4 * FACTOR[:, 1:]), dim=1)
        few = filtered_directions(Swing(), small, START, DT, STEPS, setting(), 2)
        assert few.directions.shape == (2, 1)
        assert 0.0 < few.left_out < 0.02


@torch.no_grad()
def test_directions_keep_the_covariance_where_all_of_them_may_stay():
    idle = torch.cat((FACTOR, torch.zeros(2, 30, **DOUBLE)), dim=1)
    both = directions(2, idle)
    close(both @ both.T, FACTOR @ FACTOR.T, 1e-6)
    assert directions(50, idle).shape == (2, 2)
    close(directions(1, idle).abs(), both[:, :1].abs(), 1e-6)


class Late(Position):
    """Positions, seen only in the second half."""

    def in_view(self, x, t):
        return torch.full((*x.shape[:-1], 1), bool(t > STEPS * DT / 2))


@torch.no_grad()
def test_what_is_out_of_view_tells_nothing():
    updates = setting().updates
    seen = tuple(k for k in updates if k > STEPS / 2)
    hidden = directions(2, asked=setting(updates, Late(1)))
    close(hidden.abs(), directions(2, asked=setting(seen)).abs(), 0.02)
    assert float((hidden.abs() - directions(2).abs()).abs().max()) > 0.1 * float(FACTOR.abs().max())


@torch.no_grad()
def test_paths_that_leave_all_numbers_are_left_out():
    lost = torch.cat((START, torch.full((1, 2), 1e200, **DOUBLE)))
    close(directions(2, start=lost).abs(), directions(2).abs(), 1e-6)
