"""Simulated measurements and arcs of trajectories."""

from __future__ import annotations

import pytest
import torch
from scipy.stats import chi2

from ahnn.data.generate import generate
from ahnn.dynamics import make_dynamics
from ahnn.dynamics.flow_at_time import at
from ahnn.estimation import Gate, Setting, perturbed_arcs, simulated
from ahnn.estimation.gate import check_gate, thresholds
from ahnn.measurements import GroundStation, Position
from ahnn.systems import Molniya


def test_validation_arcs_spread_over_their_trajectories() -> None:
    system = Molniya(name="orbits", dt=60.0, steps=40)
    data = generate(system, 3, seed=0)
    setting = Setting(Position(), torch.ones(3).double(), system.deviations(), tuple(range(5, 61, 5)))
    arcs = perturbed_arcs(setting, data.states, float(data.times[0, 1]), 3, steps=10, seed=0)
    for b, begin in enumerate((0, 15, 30)):
        assert torch.equal(arcs.truth[b], data.states[b, begin : begin + 11])
    measured = arcs.measurements.isfinite().all(-1)
    assert measured[:, [4, 9]].all()
    assert int(measured.sum()) == 6


def test_what_is_out_of_view_is_not_measured_and_the_noise_does_not_depend_on_it():
    system = Molniya(name="orbits", dt=600.0, steps=72)
    truth = generate(system, 5, seed=3).states
    sd = torch.tensor([0.05, 1e-4, 1e-4], dtype=torch.float64)
    rows = []
    for least in (0.0, -90.0):
        station = GroundStation(60.0, 30.0, min_elevation=least)
        setting = Setting(station, sd, system.deviations(), tuple(range(2, 73, 2)))
        rows.append(simulated(setting, truth, 600.0, seed=0))
    masked, every = rows
    elevation = torch.stack([station(truth[:, k], 600.0 * k)[:, 2] for k in range(1, 73)], dim=1)
    due = torch.arange(1, 73) % 2 == 0
    assert torch.equal(masked.isfinite().all(-1), due & (elevation >= 0.0))
    assert torch.equal(every.isfinite().all(-1), due.expand(5, -1))
    assert torch.equal(masked[masked.isfinite()], every[masked.isfinite()])
    assert 0.02 < float((elevation[:, due] < 0.0).double().mean()) < 0.5


def test_a_gate_takes_what_lies_within_the_quantile_of_the_components_that_are_there():
    limits = thresholds(Gate(0.99, 3), 4)
    assert limits.tolist() == pytest.approx([0.0, *(chi2.ppf(0.99, n) for n in range(1, 5))], rel=1e-12)
    assert thresholds(Gate(0.5), 1).tolist() == pytest.approx([0.0, chi2.ppf(0.5, 1)], rel=1e-12)
    for gate in (None, Gate(1e-9, 1), Gate(1.0 - 1e-9, 1e6)):
        check_gate(gate, "gate")
    for wrong in (Gate(0.0), Gate(1.0), Gate(0.9, 0), Gate(0.9, 1.5), Gate(0.9, float("inf")), 0.9):
        with pytest.raises(ValueError, match="gate: expected a Gate"):
            check_gate(wrong, "gate")


def walk(members: int, samples: int) -> torch.Tensor:
    rng = torch.Generator().manual_seed(4)
    return torch.randn(members, samples, 2, generator=rng, dtype=torch.float64).cumsum(1)


SETTING = Setting(
    Position(1, "m"), torch.tensor([0.1]).double(), torch.tensor([2.0, 0.5]).double(), (2, 3, 30)
)


@pytest.mark.parametrize("steps", [None, 11, 50])
def test_whole_trajectories_are_arcs_that_begin_at_their_start(steps):
    truth = walk(5, 12)
    truth[2, 9:] = torch.nan  # ends early; its arc is as long as the others
    arcs = perturbed_arcs(SETTING, truth, 0.5, 3, steps=steps, seed=1)
    assert torch.equal(arcs.truth.nan_to_num(9e9), truth[[0, 2, 4]].nan_to_num(9e9))
    assert arcs.dt == 0.5
    assert SETTING.first == 2
    due = [k for k in range(11) if bool(arcs.measurements[0, k].isfinite().all())]
    assert due == [1, 2]


def test_starts_and_measurements_are_off_by_their_deviations():
    truth = walk(4000, 4)
    arcs = perturbed_arcs(SETTING, truth, 0.5, 4000, steps=None, seed=1)
    off = arcs.starts - truth[:, 0]
    assert off.std(0).tolist() == pytest.approx([2.0, 0.5], rel=0.05)
    noise = arcs.measurements[:, 1:3, 0] - truth[:, 2:4, 0]
    assert noise.std(0).tolist() == pytest.approx([0.1, 0.1], rel=0.05)
    together = torch.corrcoef(torch.cat((off, noise), 1).T) - torch.eye(4)
    assert float(together.abs().max()) < 0.06
    again = perturbed_arcs(SETTING, truth, 0.5, 4000, steps=None, seed=1)
    other = perturbed_arcs(SETTING, truth, 0.5, 4000, steps=None, seed=2)
    assert torch.equal(arcs.starts, again.starts)
    assert not torch.equal(arcs.starts, other.starts)


def test_problems_are_repeated_member_by_member():
    arcs = perturbed_arcs(SETTING, walk(3, 5), 0.5, 3, steps=None, seed=0)
    twice = arcs.repeated(2)
    for whole, part in zip(twice[:3], arcs[:3], strict=True):
        assert torch.equal(whole[:3].nan_to_num(), part.nan_to_num())
        assert torch.equal(whole[3:].nan_to_num(), part.nan_to_num())
    assert twice.dt == arcs.dt
    assert torch.equal(SETTING.measurement_noise, torch.tensor([[0.1]]).double() ** 2)
    assert torch.equal(SETTING.start_covariance, torch.diag(torch.tensor([4.0, 0.25]).double()))


def test_controls_begin_with_the_arc_and_hold_or_follow_a_polygon():
    """A free mass takes up the integral of its controls; those beyond the end of a member are zero."""
    made = make_dynamics(
        "hamiltonian",
        dof=1,
        inertia=1.0,
        hamiltonian="mechanical",
        mu=None,
        inputs="cartesian",
        scaling="none",
        network={"width": 2, "depth": 1, "activation": "tanh"},
        integrator={"name": "rk4"},
        forces={"push": {"kind": "actuation", "matrix": [[1.0]]}},
        controls=1,
    ).double()
    for parameter in made.requires_grad_(False).parameters():
        parameter.zero_()
    arcs, x = perturbed_arcs(SETTING, walk(2, 4), 0.5, 2, steps=None, seed=0), torch.zeros(2, 2).double()
    assert arcs.driven(made) is made
    controls = torch.tensor([[1.0, 3.0, 7.0, 0.0], [2.0, torch.nan, 0.0, 0.0]]).double().unsqueeze(-1)
    given = arcs._replace(controls=controls)
    for linear, gained in ((False, [1.5, 0.0]), (True, [2.5, 0.0])):
        after = at(given._replace(linear=linear).driven(made), 0.5)(x, 0.5)
        assert after[:, 1].tolist() == pytest.approx(gained, abs=1e-12)
    free = lambda x, dt: x  # noqa: E731, ARG005
    assert given.driven(free) is free
