"""Learned parameters as states of a filter: against an oscillator whose parameters are states exactly."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import pytest
import torch
from evaluating import run
from helpers import close, generator
from oscillators import DOUBLE, Swing
from test_ukf_evaluation import SPRING, STIFFER
from torch.func import functional_call

from ahnn.estimation import Belief
from ahnn.estimation.force_error import of_states
from ahnn.estimation.parameter_error import ParameterError, field_columns
from ahnn.evaluation import Case
from ahnn.measurements import Position
from ahnn.uncertainty import Uncertainty
from ahnn_plugins.ukf import unscented_filter

FACTOR = torch.tensor([[0.05, 0.0], [-0.02, 0.04]], **DOUBLE)


@torch.no_grad()
def exact(x, dt):
    """The flow of (q, p, eta): each row by an oscillator of its own parameters."""
    a, b = (torch.tensor([2.0, 0.5], **DOUBLE) + x[..., 2:] @ FACTOR.T).unbind(-1)
    own = {"field.stiffness": torch.stack((a, b)).unsqueeze(-1)}
    state = x[..., :2]
    after = state + functional_call(_Step(), own, (state, dt))
    return torch.cat((after, x[..., 2:]), -1)


@torch.no_grad()
def plain(x, dt):
    return x + Swing().increment(x, dt)


class _Step(Swing):
    def forward(self, x, dt):
        return self.increment(x, dt.unsqueeze(-1) if isinstance(dt, torch.Tensor) else dt)


def error(**changes):
    return ParameterError(field_columns(Swing(), FACTOR), 2, **changes)


@pytest.mark.parametrize("size", [1.0, 0.1])
def test_a_step_is_that_of_other_parameters_to_third_order(size):
    x = torch.randn(20, 4, generator=generator(0), **DOUBLE)
    x[:, 2:] *= size
    flow = error().flow(plain)
    off = [float((flow(x, dt) - exact(x, dt)).abs().max()) for dt in (0.1, 0.05)]
    moved = float((exact(x, 0.1) - exact(x * torch.tensor([1.0, 1.0, 0.0, 0.0]), 0.1))[:, :2].abs().max())
    assert off[0] < 0.1 * moved
    assert off[1] < off[0] / 6  # of a single step: 8
    per_row = torch.full((20,), 0.1, **DOUBLE)
    close(flow(x, per_row), flow(x, 0.1), 1e-12)


def test_a_filter_learns_the_parameters_as_one_whose_flow_has_them():
    truth = torch.tensor([[1.0, 0.0, 1.5, -1.0], [0.3, 1.0, -1.0, 0.5]], **DOUBLE)
    rows, x = [], truth
    for _ in range(400):
        x = exact(x, 0.02)
        rows.append(x[:, :1])
    measurements = torch.stack(rows, 1) + 0.01 * torch.randn(2, 400, 1, generator=generator(1), **DOUBLE)
    start = Belief(truth[:, :2] + 0.02, 0.05 * torch.eye(2, **DOUBLE).expand(2, 2, 2))
    learning, noise = error(), torch.tensor([[1e-4]], **DOUBLE)
    sensor, nothing = learning.measurement(Position(1)), torch.zeros(4, 4, **DOUBLE)
    lifted, q = learning.belief(start), learning.process_noise(torch.zeros(2, 2, **DOUBLE), 0.02)
    assert torch.equal(q, nothing)
    flow = learning.flow(plain)
    ours, theirs = (
        unscented_filter(f, lifted, measurements, sensor, nothing, noise, 0.02) for f in (flow, exact)
    )
    deviations = theirs.chols.square().sum(-1).sqrt()
    assert float(((ours.means - theirs.means) / deviations).abs().max()) < 0.1
    close(ours.chols[:, -1], theirs.chols[:, -1], 0.03)
    assert bool((deviations[:, -1, 2:] < 0.9).all())  # it did learn
    assert float(((theirs.means - x.unsqueeze(1))[:, -1] / deviations[:, -1]).abs().max()) < 3.5
    left = of_states(ours, 2)
    assert left.means.shape[-1] == left.state.belief.mean.shape[-1] == left.chols.shape[-1] == 2


def test_a_belief_and_a_factor_of_the_noise_widen_the_parameters_alone():
    belief = Belief(torch.ones(2, 2, **DOUBLE), torch.eye(2, **DOUBLE).expand(2, 2, 2))
    found = error(size=torch.tensor([2.0, 3.0], **DOUBLE)).belief(belief)
    close(found.mean, torch.tensor([[1.0, 1.0, 0.0, 0.0]] * 2, **DOUBLE), 1e-12)
    close(found.chol.diagonal(dim1=1, dim2=2), torch.tensor([[1.0, 1, 2, 2], [1, 1, 3, 3]], **DOUBLE), 1e-12)


def test_columns_are_how_the_field_moves_along_directions():
    x = torch.randn(7, 2, generator=generator(4), **DOUBLE)
    moved, q = field_columns(Swing(), FACTOR)(x), x[:, 0]
    close(moved[:, 1], torch.stack((-q, -(q**3)), -1) @ FACTOR, 1e-5)
    assert float(moved[:, 0].abs().max()) == 0.0


@pytest.mark.slow
def test_the_filter_of_a_model_is_consistent_that_knows_how_well_its_parameters_are_known(
    make_case: Callable[..., Case],
) -> None:
    known = Uncertainty(0.02 * torch.eye(2, 1).double(), torch.zeros(2).double(), 1.0, {})
    case = dataclasses.replace(make_case(SPRING, Swing(STIFFER.stiffness, 0.0)), uncertainty=known)
    findings = run(case, group="ukf_parameter_error")
    noise = findings.numbers["process_noise"]
    assert (noise["from"], noise["directions"], noise["left_out"]) == ("parameter_error", 1, 0.0)
    told = findings.numbers["filters"]["ukf"]["model"]["perturbed"]
    assert told["status"]["OK"] == 6
    ignorant = run(case, "process_noise=[1e-12,1e-12]").numbers["filters"]["ukf"]["model"]["perturbed"]
    assert told["nees"]["mean"] < 4.0 < ignorant["nees"]["mean"]
    assert told["whole_arc"]["position"] < ignorant["whole_arc"]["position"]
