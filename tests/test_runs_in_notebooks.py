"""Runs as notebooks need them: in one line, as tables and figures, moved, differentiated."""

from __future__ import annotations

import copy
import html
from dataclasses import replace

import pytest
import torch
from helpers import close

import ahnn
from ahnn.errors import UserError
from ahnn.uncertainty import Uncertainty

ORBIT = torch.tensor([[7000.0, 0.0, 0.0, 0.0, 7.5, 0.1]], dtype=torch.float64)


@pytest.fixture(scope="module")
def mechanical():
    return ahnn.load("molniya_mechanical")


def test_a_run_is_one_line_and_in_notebooks_a_table(mechanical):
    said = repr(mechanical)
    assert said.startswith("Run(molniya: mechanical Hamiltonian, isotropic inputs; 1249 parameters, dt=60 s")
    assert "\n" not in said
    assert "true start           0.941    0.396" in mechanical._repr_html_()
    assert str(mechanical.results) in html.unescape(mechanical.results._repr_html_())
    prediction = mechanical.predict(ORBIT, [0.0, 60.0])
    unknown = "nonlinearity=None, samples=None, joint_nonlinearity=None"
    shapes = f"times=(2,), states=(1, 2, 6), covariances=None, novelty=(1, 2), {unknown}"
    assert repr(prediction) == f"Prediction({shapes})"
    data = ahnn.Trajectories(torch.zeros(4, 9, 2), torch.arange(9.0))
    assert repr(data) == "Trajectories(states=(4, 9, 2), times=(9,), controls=None, linear=False)"


def test_a_run_of_another_type_leaves_the_first_as_it_is(mechanical):
    single = mechanical.to("cpu", torch.float32)
    assert {p.dtype for p in single.dynamics.parameters()} == {torch.float32}
    assert {p.dtype for p in mechanical.dynamics.parameters()} == {torch.float64}
    assert single.rollout(ORBIT, 3).dtype == torch.float32
    close(single.rollout(ORBIT, 3), mechanical.rollout(ORBIT, 3), 1e-5)
    assert torch.equal(single.to(dtype=torch.float64).novelty(ORBIT), single.novelty(ORBIT))


def test_a_covariance_moves_with_its_run(mechanical):
    count = sum(p.numel() for p in mechanical.dynamics.parameters())
    known = Uncertainty(torch.eye(count).double(), torch.zeros(count).double(), 1.0, {})
    run = replace(
        mechanical,
        uncertainty=replace(known, before=mechanical.dynamics, tangent=(mechanical.dynamics, known)),
    )
    moved = run.to("meta").uncertainty
    assert {moved.factor.device.type, moved.offset.device.type} == {"meta"}
    assert next(moved.before.parameters()).is_meta
    assert next(moved.tangent[0].parameters()).is_meta
    assert moved.tangent[1].factor.is_meta
    assert not run.uncertainty.factor.is_meta


def test_gradients_flow_through_a_prediction(mechanical):
    """At uneven times, of which some take several steps; against central differences."""
    run, times = copy.deepcopy(mechanical), [0.0, 50.0, 200.0, 210.0]
    run.dynamics.requires_grad_()
    start, weight = ORBIT.clone().requires_grad_(), run.dynamics.field.potential.network.output.weight
    found = run.predict(start, times)
    known = mechanical.predict(ORBIT, times)
    close(found.states, known.states, 1e-14)
    assert torch.equal(found.novelty, known.novelty)
    found.states[0, 2, 1].backward()
    for given, step in ((start, 1e-2), (weight, 1e-4)):
        ends = []
        for h in (step, -step):
            with torch.no_grad():
                given.view(-1)[1] += h
                ends.append(float(run.predict(start, times).states[0, 2, 1]))
                given.view(-1)[1] -= h
        assert float(given.grad.view(-1)[1]) == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-5)
    with torch.no_grad():
        assert not run.predict(start, times).states.requires_grad


def test_a_figure_shows_the_prediction(mechanical):
    figure = mechanical.plot(ORBIT[0], [0.0, 60.0, 120.0])
    states = mechanical.predict(ORBIT, [0.0, 60.0, 120.0]).states[0]
    lines = [line.get_ydata() for panel in figure.axes[:2] for line in panel.lines]
    close(torch.stack([torch.as_tensor(line) for line in lines], -1), states, 1e-14)
    assert figure._repr_png_().startswith(b"\x89PNG")
    assert len(mechanical.plot().axes[0].lines[0].get_xdata()) == 301
    for start in (torch.cat((ORBIT, ORBIT)), None):
        with pytest.raises(UserError, match="start: expected one state of the space"):
            replace(mechanical, domain=None).plot(start)
