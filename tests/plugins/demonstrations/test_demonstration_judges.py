"""What the demonstrations say of learned flows whose errors are known exactly."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
import torch
from cases import trajectories
from helpers import close

from ahnn.dynamics import make_dynamics
from ahnn.errors import UserError
from ahnn.evaluation import Case, Who
from ahnn.evaluation.results import plain
from ahnn.rollouts import rollout
from ahnn.systems import Molniya
from ahnn.systems.truth import exact_flow
from ahnn.types import Space, Trajectories, Units
from ahnn_plugins.demonstrations import Attraction, Horizon
from ahnn_plugins.demonstrations.horizon import KNOWN, TWO_BODY, fitted_start
from ahnn_plugins.demonstrations.two_body import kepler
from ahnn_plugins.ukf.plugin import UKFEvaluation

MU = 2.0
MASSES = {"light": 1e-6, "heavy": 4e-6}
STRONGER = 3e-5
"""By so much the model's attraction is too strong, relative."""


def bodies(segments: int) -> Trajectories:
    """Two bodies about a centre, each with the sum of both parameters, as the two-body problem has it."""
    turns = torch.arange(segments, dtype=torch.float64).repeat_interleave(2)
    times = 10 * turns.unsqueeze(1) + torch.arange(10, dtype=torch.float64)
    mu = MU + torch.tensor(list(MASSES.values()), dtype=torch.float64).repeat(segments).unsqueeze(1)
    first = torch.tensor([[1.0, 0, 0, 0, 1.3, 0.1], [0, 2.5, 0, -0.9, 0, 0.1]], dtype=torch.float64)
    start = first.repeat(segments, 1).unsqueeze(1).expand(-1, 10, -1)
    return Trajectories(kepler(start, times, mu), times)


def planets_case(folder: Path) -> Case:
    def energy(x):
        return x[..., 3:].square().sum(-1) / 2 - MU * (1 + STRONGER) / x[..., :3].norm(dim=-1)

    def flow(x, dt):
        return kepler(x, torch.as_tensor(dt, dtype=x.dtype).expand(x.shape[:-1]), MU * (1 + STRONGER))

    data = bodies(3)
    space = Space("bodies", ("x", "y", "z", "vx", "vy", "vz"), Units("d", "au", "au/d", "1"))
    parts = {"test": data, "validation": data, "train": data}
    fields = {"label": "learned", "assumes": "all", "truth": None, "integrator": None, "dt": 1.0}
    return Case(space=space, flow=flow, energy=energy, perturbation=None, folder=folder, **parts, **fields)


def test_mu_is_read_off_the_potential_and_kepler_stands_beside(tmp_path):
    case = planets_case(tmp_path)
    judge = Attraction(MU, MASSES)
    judge.check(None, case.space, 9)
    findings = judge(case)
    numbers = plain(findings.numbers)
    assert numbers["relative_difference"] == pytest.approx(STRONGER, rel=1e-6)
    (row,) = findings.rows
    assert row.who == Who("Kepler", "true")
    assert row.scores.position < 1e-13
    assert "+3.0e-05" in row.note
    for name, body in numbers["bodies"].items():
        assert body["relative_difference"] == pytest.approx(STRONGER, rel=1e-6)
        assert body["relative_mass"] == MASSES[name] / MU
        assert body["position_error"]["Kepler"] < 1e-13 < 1e-6 < body["position_error"]["learned"]
    assert findings.figures.keys() == {"attraction", "ahead"}


def test_a_model_without_an_energy_or_data_in_a_plane_have_no_attraction(tmp_path):
    case = planets_case(tmp_path)
    with pytest.raises(UserError, match="expected a Hamiltonian; received learned"):
        Attraction(MU, MASSES)(dataclasses.replace(case, energy=None))
    with pytest.raises(UserError, match="bodies: expected bodies in three dimensions"):
        Attraction(MU, MASSES).check(None, Space("plane", ("x", "y", "px", "py")), 9)


EARTH = Molniya(name="earth", dt=300.0, steps=575)
ROWS = {"period": 86400.0, "unit": "day"}
OBLATE = dataclasses.replace(EARTH, name="J2", j2=1.1 * EARTH.j2)


def satellites_case(folder: Path) -> Case:
    """The model has a tenth too little oblateness, one hundredth of the error of `OBLATE`."""
    learned = exact_flow(dataclasses.replace(EARTH, name="learned", j2=1.001 * EARTH.j2))
    data = trajectories(EARTH, 1, 1)
    parts = {"test": data, "validation": data, "train": data}
    fields = {"label": "learned", "assumes": "all", "truth": None, "integrator": None, "dt": 300.0}
    space = EARTH.space
    return Case(space=space, flow=learned, energy=None, perturbation=None, folder=folder, **parts, **fields)


@pytest.fixture(scope="module")
def horizon(tmp_path_factory):
    judge = Horizon(60, 0.01, 0, beside=OBLATE, **ROWS)
    case = satellites_case(tmp_path_factory.mktemp("horizon"))
    judge.check(None, case.space, 575)
    return judge(case)


def test_days_ahead_and_errors_of_each_day(horizon):
    daily = horizon.numbers["errors"]
    assert horizon.numbers["nearer"] == {"true": 2, "fitted": 2}
    for kind in ("true", "fitted"):
        assert all(len(errors) == 2 for errors in daily[kind].values())
        learned, oblate, two_body = (torch.tensor(daily[kind][k]) for k in ("learned", "J2", TWO_BODY))
        assert bool((5 * learned < oblate).all() and (2 * oblate < two_body).all())
    close(torch.tensor(daily["true"]["J2"]), 100 * torch.tensor(daily["true"]["learned"]), 0.1)
    assert [row.who for row in horizon.rows] == [Who("J2", "true"), Who(TWO_BODY, "true")]
    assert "2 of 2 from the true start, 2 of 2 from the fitted start" in horizon.notes[0]


def test_a_fitted_start_of_the_exact_flow_is_the_true_one(tmp_path):
    case = satellites_case(tmp_path)
    judge = Horizon(60, 1e-4, 0, beside=OBLATE, **ROWS)
    start = fitted_start(exact_flow(EARTH), judge._measured(case), case)
    close(start[:, :3], case.test.states[:, 0, :3], 1e-7)
    close(start[:, 3:], case.test.states[:, 0, 3:], 1e-6)


@pytest.mark.parametrize("arc", [3, 576])
def test_an_arc_that_fits_no_start_is_refused(arc):
    with pytest.raises(UserError, match=f"arc: expected 6 to 575 samples.*received {arc}"):
        Horizon(arc, 1.0, 0, beside=OBLATE, **ROWS).check(None, EARTH.space, 575)


def test_other_units_are_refused():
    with pytest.raises(UserError, match="beside: expected data in Units"):
        Horizon(9, 1.0, 0, beside=OBLATE, **ROWS).check(None, Space("x", ("q", "p") * 3), 575)
    with pytest.raises(UserError, match=r"mu: expected mu of two-body motion.*received neither"):
        Horizon(9, 1.0, 0, **ROWS)


def test_known_forces_alone_stand_beside_a_model_that_adds_to_them(tmp_path):
    """Two bodies with a mass each, and a model that knows the attraction of the centre and pulls outwards."""
    case = planets_case(tmp_path)
    options = {"dof": 3, "inertia": 1.0, "hamiltonian": "central_body", "mu": MU, "inputs": "radial"}
    options |= {"scaling": "none", "network": {"width": 4, "depth": 1, "activation": "tanh"}}
    torch.manual_seed(0)
    learned = make_dynamics("hamiltonian", integrator={"name": "dopri8"}, **options).double()
    for parameter in learned.parameters():
        parameter.data += 0.01
    judge = Horizon(8, 1e-9, 0, period=5.0, unit="week", mu=[MU * (1 + STRONGER), MU])
    judge.check(None, case.space, 9)
    start = case.test.states[:, 0]
    kinds = judge(dataclasses.replace(case, flow=learned.frozen())).numbers["errors"]
    assert all(len(errors) == 2 for kind in kinds.values() for errors in kind.values())
    assert max(kinds["fitted"][TWO_BODY]) < 1e-4 < 1e-3 < min(kinds["fitted"]["learned"])
    known = rollout(
        make_dynamics("hamiltonian", integrator={"name": "dopri8"}, **options).double(), start, 1.0, 10
    )
    errors = (known - case.test.states)[..., :3].norm(dim=-1).unflatten(1, (2, 5))
    close(torch.tensor(kinds["true"][KNOWN]).double(), errors.square().mean((0, 2)).sqrt(), 1e-6)


def ukf(**changes) -> UKFEvaluation:
    options = {"cadence": 30, "times": None, "measurement": "position", "measurement_sd": 0.1}
    options |= {"start_sd": None, "process_noise": (1e-3, 1e-6), "alpha": 1.0, "beta": 2.0, "kappa": 0.0}
    options |= {"form": "square_root", "gate": None, "patience": 5, "smoother": False, "tuning": None}
    return UKFEvaluation(**(options | {"least_squares": False, "seed": 0} | changes))


def test_a_system_beside_the_filter_filters_as_a_model_of_the_same_flow_does(tmp_path):
    case = satellites_case(tmp_path)
    short = Trajectories(case.test.states[:, :121], case.test.times[:, :121])
    case = dataclasses.replace(case, test=short, validation=short, flow=exact_flow(OBLATE))
    with pytest.raises(UserError, match="expected a system with known equations"):
        ukf().check(None, case.space, 120)
    with pytest.raises(UserError, match="beside: expected data without known equations"):
        ukf(beside=OBLATE).check(EARTH, case.space, 120)
    findings = ukf(beside=OBLATE)(case)
    model, beside = findings.rows[::2]
    assert (model.who, beside.who) == (Who("model", "true", "ukf"), Who("J2", "true", "ukf"))
    assert model.scores == beside.scores
    filters = findings.numbers["filters"]["ukf"]
    assert filters["model"]["true"]["nees"] == filters["J2"]["true"]["nees"]
