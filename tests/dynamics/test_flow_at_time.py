"""Flows that depend on time and controls, from an instant on: exact motions of a mass that is pushed."""

from __future__ import annotations

import pytest
import torch
from helpers import close

from ahnn.dynamics import flow_at_time, make_dynamics
from ahnn.dynamics.flow_at_time import Bound, steered, wrapped
from ahnn.errors import UserError

DOUBLE = {"dtype": torch.float64}
MASS = 1.5
STATES = torch.tensor([[0.0, 0.0], [1.0, -2.0], [0.5, 3.0], [-1.0, 1.0]], **DOUBLE)


def mass(forces, controls=0):
    """A free mass beside the forces."""
    made = make_dynamics(
        "hamiltonian",
        dof=1,
        inertia=MASS,
        hamiltonian="mechanical",
        mu=None,
        inputs="cartesian",
        scaling="none",
        network={"width": 4, "depth": 1, "activation": "tanh"},
        integrator={"name": "rk4"},
        forces=forces,
        controls=controls,
    ).double()
    for parameter in made.parameters():
        parameter.data.zero_()
    return made.requires_grad_(False)


PUSHED = mass({"controls": {"kind": "actuation", "matrix": [[1.0, -2.0]]}}, 2)
TIMES = torch.tensor([1.0, 2.0, 4.0], **DOUBLE)
CONTROLS = torch.tensor([[1.0, 0.5], [3.0, 0.0], [-1.0, 2.0]], **DOUBLE)
PUSH = CONTROLS @ torch.tensor([1.0, -2.0], **DOUBLE)  # 0, 3, -5


def moved(x, dt, push, slope=0.0):
    """Where the states are after dt under push + slope t."""
    q, p = x.unbind(-1)
    after = q + (p * dt + push * dt**2 / 2 + slope * dt**3 / 6) / MASS
    return torch.stack((after, p + push * dt + slope * dt**2 / 2), -1)


@pytest.mark.parametrize(
    ("time", "held", "linear", "slope"),
    [
        (0.5, 0.0, 0.0, 0.0),
        (1.0, 0.0, 0.0, 3.0),
        (1.25, 0.0, 0.75, 3.0),
        (2.0 - 1e-9, 3.0, 3.0, -4.0),
        (2.0 - 1e-8, 0.0, 3.0, 3.0),
        (3.5, 3.0, -3.0, -4.0),
        (4.0, -5.0, -5.0, 0.0),
        (7.0, -5.0, -5.0, 0.0),
    ],
)
def test_known_controls_are_held_or_follow_a_polygon(time, held, linear, slope):
    """Before the first time they are those of the first, and after the last those of the last."""
    close(
        flow_at_time.at(steered(PUSHED, TIMES, CONTROLS), time)(STATES, 0.2), moved(STATES, 0.2, held), 1e-7
    )
    polygon = flow_at_time.at(steered(PUSHED, TIMES, CONTROLS, linear=True), torch.tensor(time, **DOUBLE))
    close(polygon(STATES, 0.2), moved(STATES, 0.2, linear, slope), 1e-7)


def test_one_control_is_enough():
    one = mass({"controls": {"kind": "actuation", "matrix": [[-2.0]]}}, 1)
    after = flow_at_time.at(steered(one, [0.0, 1.0], [[1.0], [3.0]]), 1.0)(STATES, 0.5)
    close(after, moved(STATES, 0.5, -6.0), 1e-13)


def test_members_have_controls_of_their_own():
    """Two states in a row for each of two members."""
    flow = steered(PUSHED, TIMES, torch.stack((CONTROLS, -2 * CONTROLS))).at(2.5)
    push = torch.tensor([3.0, 3.0, -6.0, -6.0], **DOUBLE)
    close(flow(STATES, 0.5), moved(STATES, 0.5, push), 1e-13)


def test_transitions_are_those_of_plain_states():
    after, matrices = steered(PUSHED, TIMES, CONTROLS).at(2.0).transition(STATES, 0.3)
    close(after, moved(STATES, 0.3, 3.0), 1e-13)
    close(matrices, torch.tensor([[1.0, 0.3 / MASS], [0.0, 1.0]], **DOUBLE).expand(4, 2, 2), 1e-12)


def test_a_flow_of_time_alone_begins_at_its_instant():
    """The momentum is the integral of cos(w t), to the order of the method."""
    forced = mass({"forcing": {"frequency": 2.0, "cosine": [1.0]}})
    t = torch.tensor(3.0, **DOUBLE)
    after = flow_at_time.at(forced, 3.0)(STATES, 0.01)
    close(after[:, 1] - STATES[:, 1], ((2 * (t + 0.01)).sin() - (2 * t).sin()).expand(4) / 2, 1e-10)


def test_flows_are_wrapped_whether_they_depend_on_time_or_not():
    doubled = lambda flow: lambda x, dt: 2 * flow(x, dt)  # noqa: E731
    free = mass({})
    assert flow_at_time.at(free, 3.0) is free
    close(wrapped(free, doubled)(STATES, 0.5), 2 * moved(STATES, 0.5, 0.0), 1e-13)
    flow = wrapped(steered(PUSHED, TIMES, CONTROLS), doubled)
    assert flow.clock == steered(PUSHED, TIMES, CONTROLS).clock == 1  # time alone: controls are known
    close(flow_at_time.at(flow, 2.0)(STATES, 0.5), 2 * moved(STATES, 0.5, 3.0), 1e-13)


def test_what_is_not_known_is_a_message():
    for flow in (steered(PUSHED, TIMES, CONTROLS), wrapped(steered(PUSHED, TIMES, CONTROLS), lambda f: f)):
        with pytest.raises(UserError, match="flow: expected the time at which a step begins"):
            flow(STATES, 0.1)
    with pytest.raises(
        UserError, match=r"received forces that depend on controls. `ahnn.dynamics.flow_at_time.steered`"
    ):
        Bound(PUSHED, 0.0)(STATES, 0.1)
    for times, controls in (
        (TIMES, CONTROLS[:, :1]),
        (TIMES, CONTROLS[:2]),
        (TIMES.flip(0), CONTROLS),
        (torch.tensor([1.0, 1.0, 2.0]), CONTROLS),
        (TIMES[None], CONTROLS),
    ):
        with pytest.raises(
            UserError, match=r"expected finite, increasing times \(T,\) and controls \(T, 2\); r"
        ):
            steered(PUSHED, times, controls)
    for none in (mass({}), mass({"forcing": {"frequency": 2.0}})):
        with pytest.raises(UserError, match="steered: expected a flow with controls; received"):
            steered(none, TIMES, CONTROLS)
