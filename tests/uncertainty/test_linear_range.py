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
from ahnn.uncertainty import LINEAR, largest_displacement, nonlinearity

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
    index = nonlinearity(lambda _, x: x + x * x / 2, states, moves, torch.full_like(moves, 1e-3))
    close(index, torch.tensor([[0.0, 0.0, 0.02**2 / 2 / 1e-3]], **DOUBLE), 1e-7)


@torch.no_grad()
def test_a_spring_is_linear_however_wide_its_bands_are():
    wide = torch.tensor([[3.0]], **DOUBLE)
    found = predicted(Learned(), torch.tensor([[1.0, 0.0]], **DOUBLE), TIMES, 0.05, Knowledge(wide))
    assert float(found.deviations[..., 0].max()) > 1
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
    assert torch.equal(together([narrow, wide]).nonlinearity, wide.nonlinearity)
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
