"""Directions of parameters for a filter: against a consider filter of states and parameters together."""

from __future__ import annotations

import pytest
import torch
from helpers import close, generator
from oscillators import DOUBLE, Swing, times
from torch.func import functional_call, jacrev, vmap

from ahnn.errors import UserError
from ahnn.measurements import Instrument, Segment
from ahnn.shooting.path_sensitivities import path, steps_between
from ahnn.uncertainty import directions
from ahnn.uncertainty.directions import Watched, filtered_directions

ROWS, INTERVALS, SAMPLES = 4, 30, 10
FACTOR = 0.02 * torch.tensor([[0.05, 0.0], [-0.02, 0.04]], **DOUBLE)
START_SD = torch.tensor([5e-4, 2e-4], **DOUBLE)
WEIGHED = range(3, INTERVALS + 1, 3)


class Bent:
    """q + q^2/5, and q p."""

    names, units = ("a", "b"), ("1", "1")

    def __call__(self, x, t):
        q, p = x.unbind(-1)
        return torch.stack((q + 0.2 * q * q, q * p), -1)

    def residual(self, y, y_pred):
        return y - y_pred


def watched(deviations=(2e-4, 1e-3), rows=ROWS):
    """Irregular times, of whose numbers half are measured; none where it begins."""
    start = torch.randn(rows, 2, generator=generator(3), **DOUBLE)
    values = torch.zeros(rows, INTERVALS + 1, 2, **DOUBLE)
    gone = torch.rand(values.shape, generator=generator(4)) < 0.5
    gone[:, 0] = True
    instrument = Instrument(Bent(), torch.tensor(deviations, **DOUBLE), 0.02, 1, 1.0)
    segment = Segment(values.masked_fill(gone, torch.nan), times(rows, INTERVALS), instrument)
    return Watched(start, START_SD, segment)


def step(z, dt):
    """A step of (q, p, eta) by RK4, each by an oscillator of its own parameters."""
    own = {"field.stiffness": torch.tensor([2.0, 0.5], **DOUBLE) + FACTOR @ z[2:]}
    return torch.cat((functional_call(_Step(), own, (z[:2], dt)), z[2:]))


class _Step(Swing):
    def forward(self, x, dt):
        return x + self.increment(x, dt)


def joint(given):
    """P_eta,x P_x^-1 P_x,eta of paths, times, (M, 2, 2), by the covariance of (q, p, eta) in one matrix."""
    steps, seen = steps_between(given.segment.times, 0.02), ~given.segment.values.isnan()
    start = torch.cat((START_SD**2, torch.ones(2, **DOUBLE)))
    z, both = torch.nn.functional.pad(given.start, (0, 2)), torch.diag(start).expand(len(seen), 4, 4)
    found, here = [], 0
    for k, there in enumerate(steps.ends.tolist()):
        for dt in steps.lengths[:, here:there].unbind(1):
            moved, z = vmap(jacrev(step))(z, dt), vmap(step)(z, dt)
            both = moved @ both @ moved.mT
        if k in WEIGHED:
            followed = seen[:, k:].any((1, 2))[:, None, None]
            found.append(followed * both[:, 2:, :2] @ torch.linalg.inv(both[:, :2, :2]) @ both[:, :2, 2:])
        both = torch.stack([updated(*pair, given.segment) for pair in zip(both, z, seen[:, k], strict=True)])
        here = there
    return torch.cat(found)


def updated(both, z, seen, segment):
    """The covariance of one member after the numbers that it sees; parameters are considered, not learned."""
    if not bool(seen.any()):
        return both
    rows = jacrev(lambda z: segment.instrument.measurement(z[:2], 0.0))(z)[seen]
    noise = torch.diag(segment.instrument.deviations[seen] ** 2)
    gain = both @ rows.mT @ torch.linalg.inv(rows @ both @ rows.mT + noise)
    gain[2:] = 0.0
    left = torch.eye(4, **DOUBLE) - gain @ rows
    return left @ both @ left.mT + gain @ noise @ gain.mT


@pytest.fixture(autouse=True)
def ten_times(monkeypatch):
    monkeypatch.setattr(directions, "SAMPLES", SAMPLES)


@pytest.mark.parametrize("deviations", [(2e-4, 1e-3), (1e-2, 5e-5), (1.0, 1.0)])
def test_directions_are_those_that_a_consider_filter_does_not_tell_from_measurements(deviations):
    given = watched(deviations)
    grams = joint(given)
    sizes, axes = torch.linalg.eigh(grams.sum(0))
    assert float(sizes[0]) < 0.5 * float(sizes[1])  # there is a first one
    found, expected = filtered_directions(Swing(), FACTOR, given, 2).directions, FACTOR @ axes.flip(1)
    close(found * (found * expected).sum(0).sign(), expected, 5e-4)
    assert bool((found.amax(0) == found.abs().amax(0)).all())  # a sign of its own, for saved filters
    assert not found.requires_grad
    second = axes[:, 0]
    one = filtered_directions(Swing(), FACTOR, given, 1)
    assert one.left_out == pytest.approx(float((second @ grams @ second).max()), rel=2e-3)


def test_there_are_as_few_directions_as_leave_out_next_to_nothing():
    small = torch.cat((FACTOR[:, :1], 1e-3 * FACTOR[:, 1:], torch.zeros(2, 30, **DOUBLE)), dim=1)
    few = filtered_directions(Swing(), small, watched(), 50, enough=0.01)
    assert few.directions.shape == (2, 1)
    assert 0.0 < few.left_out < 0.02
    both = filtered_directions(Swing(), small, watched(), 50, enough=few.left_out / 4)
    assert both.directions.shape == (2, 2)
    close(both.directions @ both.directions.T, small @ small.T, 1e-5)
    assert both.left_out == 0.0


def test_paths_that_leave_all_numbers_are_left_out():
    given, more = watched(), watched(rows=ROWS + 1)
    lost = more._replace(start=torch.cat((given.start, torch.full((1, 2), 1e200, **DOUBLE))))
    kept = more._replace(start=given.start, segment=more.segment.rows(slice(ROWS)))
    expected = filtered_directions(Swing(), FACTOR, kept, 2).directions
    close(filtered_directions(Swing(), FACTOR, lost, 2).directions, expected, 1e-6)
    none = lost._replace(start=lost.start[-1:], segment=more.segment.rows(slice(ROWS, None)))
    with pytest.raises(
        UserError, match="expected a model whose trajectories from the training states stay finite"
    ):
        filtered_directions(Swing(), FACTOR, none, 2)


def test_paths_of_an_oscillator_are_those_of_the_steps_that_were_asked_for():
    given = watched()
    steps = steps_between(given.segment.times, 0.02)
    z = torch.nn.functional.pad(given.start, (0, 2))
    for dt in steps.lengths.unbind(1):
        z = vmap(step)(z, dt)
    close(z[:, :2], path(Swing().increment, given.start, steps.lengths)[:, -1].detach(), 1e-12)
