"""Index of nonlinearity: closed forms of maps, second derivatives of a pendulum's flow, a linear spring."""

from __future__ import annotations

import numpy
import pytest
import torch
from cases import Learned
from helpers import close
from oscillators import DOUBLE, Swing

from ahnn.prediction.followed_path import Knowledge
from ahnn.prediction.propagation import predicted, together
from ahnn.shooting.path_sensitivities import path
from ahnn.uncertainty import LINEAR, asymmetry, joint_nonlinearity, largest_displacement, nonlinearity

TIMES = torch.linspace(0, 3.2, 33, **DOUBLE)


def test_the_largest_displacement_is_one_standard_deviation_along_the_principal_axis():
    columns = torch.tensor([[[3.0, 0.0, 0.4], [0.0, 2e-3, 1e-3]]], **DOUBLE)
    moved = (columns @ largest_displacement(columns).unsqueeze(-1)).squeeze()
    covariance = (columns @ columns.mT)[0].numpy()
    deviations = numpy.sqrt(numpy.diag(covariance))
    values, axes = numpy.linalg.eigh(covariance / numpy.outer(deviations, deviations))
    expected = torch.from_numpy(deviations * axes[:, -1] * numpy.sqrt(values[-1]))
    close(moved * moved[0].sign(), expected * expected[0].sign(), 1e-9)


@torch.no_grad()
def test_a_quadratic_map_bends_by_its_square():
    """X' = x + x^2 / 2, of which each displacement is given: m_1^2 / 2, then also what became of it."""
    states = torch.tensor([0.1, 0.105, 0.1105125], **DOUBLE).view(1, 3, 1)
    moves = torch.tensor([0.0, 0.02, 0.03], **DOUBLE).view(1, 3, 1)
    bends = asymmetry(lambda _, x: x + x * x / 2, states, moves)
    index = nonlinearity(bends, torch.full_like(moves, 1e-3))
    close(index, torch.tensor([[0.0, 0.0, 0.02**2 / 2 / 1e-3]], **DOUBLE), 1e-7)


def bent(angle):
    """Columns of a wide and a narrow error at an angle, and the asymmetry of a track bent across them."""
    wide, narrow, bend = 20.0, 0.1, 0.03
    turn = torch.tensor(
        [[numpy.cos(angle), -numpy.sin(angle)], [numpy.sin(angle), numpy.cos(angle)]], **DOUBLE
    )
    columns = turn @ torch.diag(torch.tensor([wide, narrow], **DOUBLE))
    return columns, turn @ torch.tensor([0.0, bend], **DOUBLE)


@pytest.mark.parametrize("angle", [0.0, 0.3, 0.8])
def test_the_joint_index_gives_the_mean_nees_of_a_bent_track_in_every_orientation(angle):
    """A point of the track is C (u, v) + b u^2 with normal u, v, integrated by Gauss-Hermite quadrature."""
    columns, bend = bent(angle)
    index = joint_nonlinearity(bend.view(1, 1, 2), columns.view(1, 1, 2, 2))
    points, weights = (torch.from_numpy(part) for part in numpy.polynomial.hermite_e.hermegauss(9))
    u, v = torch.meshgrid(points, points, indexing="ij")
    off = torch.stack((u, v), dim=-1) @ columns.T + (u * u).unsqueeze(-1) * bend
    nees = (off @ torch.linalg.inv(columns @ columns.T) * off).sum(-1)
    mean = (weights[:, None] * weights * nees).sum() / weights.sum() ** 2
    close(2 + 3 * index.squeeze() ** 2, mean, 1e-9)
    close(index.squeeze(), torch.tensor(0.3, **DOUBLE), 1e-9)


def test_the_bands_of_components_across_a_bent_track_hide_its_bend():
    columns, bend = bent(0.8)
    deviations = columns.square().sum(-1).sqrt()
    assert float(nonlinearity(bend.view(1, 1, 2), deviations.view(1, 1, 2))) < 0.01


def test_directions_that_no_table_resolves_count_as_thick_as_it_does():
    columns = torch.diag(torch.tensor([5.0, 0.0], **DOUBLE)).view(1, 1, 2, 2)
    turn = torch.tensor([[1.0, -1.0], [1.0, 1.0]], **DOUBLE) / 2**0.5
    across = turn @ torch.tensor([0.0, 1e-4], **DOUBLE)
    deviations = (turn @ columns).square().sum(-1).sqrt()
    expected = (across / deviations).norm() / 1e-3
    close(joint_nonlinearity(across.view(1, 1, 2), turn @ columns).squeeze(), expected, 1e-6)
    diverged = torch.full((1, 1, 2), torch.nan, **DOUBLE)
    assert float(joint_nonlinearity(diverged, turn @ columns)) == float("inf")


@torch.no_grad()
def test_a_spring_is_linear_however_wide_its_bands_are():
    wide = torch.tensor([[3.0]], **DOUBLE)
    found = predicted(Learned(), torch.tensor([[1.0, 0.0]], **DOUBLE), TIMES, 0.05, Knowledge(wide))
    assert float(found.deviations[..., 0].max()) > 1
    assert float(found.joint_nonlinearity.max()) < 1e-3
    assert float(found.nonlinearity.max()) < 1e-4  # central differences of columns in float32


@torch.no_grad()
@pytest.mark.parametrize("sd", [0.02, 0.05])
def test_the_index_of_an_oscillator_is_half_the_second_derivative_of_its_flow(sd):
    dynamics, start, e = Swing(), torch.tensor([[1.5, 0.3]], **DOUBLE), 1e-3 / sd
    factor = sd * torch.diag(torch.tensor([1.0, 2.0], **DOUBLE))
    found = predicted(dynamics, start, TIMES, 0.1, Knowledge(start=factor))

    def states(move):
        return path(dynamics.increment, start + move, TIMES.diff().unsqueeze(0))[0]

    ends = [(states(e * unit) - states(-e * unit))[-1] / (2 * e) for unit in factor]
    weights = largest_displacement(torch.stack(ends, dim=-1).unsqueeze(0))[0]
    move = e * factor @ weights
    second = (states(move) + states(-move) - 2 * states(0 * move)) / e**2
    expected = (second.abs() / 2 / found.deviations[0]).amax(-1)
    close(found.nonlinearity[0], expected, 0.02)


@torch.no_grad()
def test_a_prediction_leaves_the_linear_range_where_its_bands_are_wide():
    start = torch.tensor([[1.5, 0.3], [0.1, 0.0]], **DOUBLE)
    narrow, wide = (
        predicted(Swing(), start, TIMES, 0.1, Knowledge(start=sd * torch.eye(2, **DOUBLE)))
        for sd in (1e-3, 0.3)
    )
    assert float(narrow.nonlinearity.max()) < LINEAR < float(wide.nonlinearity[0].max())
    assert narrow.nonlinearity.shape == (2, len(TIMES))
    both = together([narrow, wide])
    assert torch.equal(both.nonlinearity, wide.nonlinearity)
    assert torch.equal(both.joint_nonlinearity, wide.joint_nonlinearity)
    assert bool((wide.joint_nonlinearity >= wide.nonlinearity).all())
    assert predicted(Swing(), start, TIMES, 0.1).nonlinearity is None


@torch.no_grad()
def test_segments_of_a_long_path_do_not_change_the_index(monkeypatch):
    start, times = torch.tensor([[1.5, 0.3]], **DOUBLE), torch.linspace(0, 10, 101, **DOUBLE)
    known = Knowledge(start=0.05 * torch.eye(2, **DOUBLE))
    whole = predicted(Swing(), start, times, 0.1, known).nonlinearity
    monkeypatch.setattr("ahnn.prediction.propagation.CELLS", 1)
    stacked = torch.stack
    nodes = []
    monkeypatch.setattr(torch, "stack", lambda parts, dim=0: nodes.append(len(parts)) or stacked(parts, dim))
    close(predicted(Swing(), start, times, 0.1, known).nonlinearity, whole, 1e-9)
    assert max(nodes) < 40  # columns of one node in four are kept
