"""Training on measurements on a simulated device: no tensor on another device, and the results of the CPU."""

from __future__ import annotations

import copy
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from helpers import SPRING, build_model, close, data_module, generator, ready_model
from hydra import compose, initialize_config_dir
from oscillators import segment
from simulated_device import simulated_device
from torch.nn.utils import parameters_to_vector

from ahnn.cli.prepare import factories_of
from ahnn.data.datamodule import WindowDataModule
from ahnn.data.sensor import Sensor
from ahnn.dynamics import HamiltonianDynamics
from ahnn.errors import UserError
from ahnn.measurements import GroundStation, Instrument, Position, Segment, Several, State
from ahnn.measurements.coloured_noise import Colour
from ahnn.paths import conf_dir
from ahnn.shooting import initial_states, normal_points
from ahnn.training import LevenbergMarquardt, Shooting
from ahnn.training.member_damping import member_damped_steps
from ahnn.training.weak import Weak
from ahnn.uncertainty import drawn, sampled_paths

DOUBLE = {"dtype": torch.float64}
KINDS = {
    "generic": {"hamiltonian": "generic", "integrator": {"name": "rk4"}},
    "separable": {"hamiltonian": "separable", "integrator": {"name": "leapfrog"}},
    "mechanical": {"hamiltonian": "mechanical", "integrator": {"name": "leapfrog"}},
    "central_body": {
        "hamiltonian": "central_body",
        "inputs": "isotropic",
        "integrator": {"name": "leapfrog"},
    },
}


@pytest.fixture(autouse=True)
def _few_iterations(monkeypatch):
    """Initial states are not fitted to the last digit: each operation on the simulated device is slow."""
    monkeypatch.setattr(initial_states, "SETTLED", 1e4)


def dynamics(kind: str = "mechanical", dof: int = 1, activation: str = "tanh") -> HamiltonianDynamics:
    torch.manual_seed(0)
    known = {"inertia": 1.0, "mu": 1.0 if kind == "central_body" else None, "inputs": "cartesian"}
    network = {"width": 5, "depth": 2, "activation": activation}
    options = {**known, "scaling": "block", **KINDS[kind]}
    return HamiltonianDynamics(dof, network=network, **options).double()


def measured(measurement=None, *, bias=False, coloured=False, student=False, **options):
    """Segments of an oscillator, with options of the instrument."""
    options = {"rows": 3, "intervals": 6, "longest": 0.2, "measurement": measurement, **options}
    batch = segment(**options)[1]
    count, changes = batch.values.shape[-1], {}
    if bias:
        changes["bias"] = torch.full((count,), 0.01, **DOUBLE)
    if coloured:
        changes["colour"] = Colour(torch.full((count,), 0.5, **DOUBLE), torch.full((count,), 0.3, **DOUBLE))
    if student:
        changes["freedom"] = torch.full((count,), 5.0, **DOUBLE)
    return batch._replace(instrument=batch.instrument._replace(**changes))


def quantities(objective, learned, batch):
    """Losses, equations and derivatives of a problem, and the parameters after a step."""
    problem = objective.problem(learned, batch)
    theta = parameters_to_vector(learned.parameters()).detach()
    loss, _, (block,) = problem.equations(theta, [p.numel() for p in learned.parameters()])
    found = {"loss": loss, "matrix": block.matrix, "gradient": block.gradient}
    if isinstance(objective, Shooting):
        found["exact gradient"] = problem.gradient(theta)
    optimizer = LevenbergMarquardt(learned.parameters(), damping=1.0, acceleration=True)
    optimizer.step(lambda: (problem, None))
    return found | {"parameters": parameters_to_vector(learned.parameters()).detach()}


def first_order(objective, learned, batch):
    """The loss of a gradient step with its gradient, and the loss of a validation."""
    loss = objective.residuals(learned, batch).square().mean()
    loss.backward()
    slope = torch.cat([p.grad.flatten() for p in learned.parameters() if p.grad is not None])
    return {"loss": loss.detach(), "slope": slope} | objective.validation(learned, batch)


def agree(objective, learned, batch, work=quantities):
    """Assert that all quantities are on the device, and equal those of the CPU up to rounding."""
    here = work(objective, copy.deepcopy(learned), batch)
    with simulated_device() as device:
        there = work(objective, copy.deepcopy(learned).to(device), batch.to(device))
        assert {name for name, value in there.items() if value.device != device} == set()
        there = {name: value.cpu() for name, value in there.items()}
    if work is quantities:
        assert not torch.equal(here["parameters"], parameters_to_vector(learned.parameters()))
    for name, value in here.items():
        close(there[name], value, 1e-4)  # Jacobians are in float32


@pytest.mark.parametrize("kind", ["generic", "separable", "mechanical"])
def test_a_step_of_shooting(kind):
    agree(Shooting(None), dynamics(kind), measured(Position(1) if kind == "mechanical" else State(1)))


@pytest.mark.parametrize("objective", [Shooting(None), Weak()], ids=["shooting", "weak"])
def test_a_gradient_step_and_a_validation(objective):
    intervals = 40 if isinstance(objective, Weak) else 6
    agree(objective, dynamics(), measured(State(1), intervals=intervals, missing=0.0), first_order)


@pytest.mark.parametrize("robust", ["huber", "student"])
def test_a_step_with_a_robust_loss(robust):
    agree(Shooting(6, robust), dynamics(), measured(State(1)))


def test_a_step_with_coloured_noise_and_a_bias():
    agree(Shooting(None), dynamics(), measured(coloured=True, bias=True))


def test_a_step_with_noise_of_student():
    agree(Shooting(None), dynamics(), measured(student=True))


def test_a_step_on_long_segments(monkeypatch):
    monkeypatch.setattr(normal_points, "POINTS", 4)
    agree(Shooting(None), dynamics(activation="gelu"), measured(intervals=30))


@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.parametrize("missing", [0.0, 0.05])
def test_a_step_of_the_weak_form(relative, missing):
    batch = measured(State(1), intervals=60, missing=missing, seed=1)
    agree(Weak("huber", relative), dynamics("generic"), batch)


def test_a_step_of_the_weak_form_of_positions():
    agree(Weak(), dynamics(), measured(Position(1), intervals=60, missing=0.0))


def test_a_step_on_ranges_and_angles():
    """Two stations, an orbit around a central body in units of its radius."""
    learned = dynamics("central_body", 3)
    start = torch.tensor([[1.2, 0.1, 0.0, 0.0, 0.9, 0.1], [0.0, 1.3, 0.1, -0.8, 0.0, 0.2]], **DOUBLE)
    places = {"radius": 1.0, "rotation_rate": 0.1, "min_elevation": -90.0}
    seen = Several([GroundStation(10.0, 20.0, **places), GroundStation(-30.0, 140.0, **places)])
    times = 0.05 * torch.arange(9, **DOUBLE).expand(2, -1)
    with torch.no_grad():
        states = [start]
        for _ in range(8):
            states.append(learned(states[-1], 0.05))
        values = seen(torch.stack(states, 1), times)
    values = values + 1e-3 * torch.randn(values.shape, generator=generator(0), **DOUBLE)
    instrument = Instrument(seen, torch.full((6,), 1e-3, **DOUBLE), 0.05, 3, 1.0)
    agree(Shooting(None), learned, Segment(values, times, instrument))


def test_batches_of_measurements_are_on_the_device_of_the_trainer(tmp_path):
    """Those of training and of validation; the closing stage gets its own on the CPU."""
    options = {"split": [0.6, 0.2, 0.2], "window": 3, "batch_size": 8, "windows_per_epoch": None}
    options |= {"emphasis": 0.0, "val_windows": None, "precision": 64, "order_seed": 0}
    source, sensor = (
        data_module(SPRING, str(tmp_path)).source,
        Sensor(SPRING.space, measured="state", noise=0.01),
    )
    data = WindowDataModule(source, **options, sensor=sensor)
    data.follow(SimpleNamespace(intervals=lambda *_: 4, segments_per_step=lambda *_: None), 1)
    with simulated_device() as device:
        data.trainer = SimpleNamespace(strategy=SimpleNamespace(root_device=device))
        for loader in (data.train_dataloader(), data.val_dataloader()):
            batch = next(iter(loader))
            assert {batch.values.device, batch.times.device, batch.instrument.deviations.device} == {device}
        assert data.whole("train").values.device.type == "cpu"


@pytest.mark.parametrize(("device", "count"), [("mps", 1), ("cuda", 2), ("cpu", 2)])
def test_measurements_need_one_device_with_float64(device, count):
    model = build_model("mechanical", SPRING)
    strategy = SimpleNamespace(root_device=torch.device(device))
    trainer: Any = SimpleNamespace(strategy=strategy, world_size=count, callbacks=[])
    expected = "accelerator: expected cpu or cuda" if device == "mps" else "devices: expected 1"
    with pytest.raises(UserError, match=f"trainer.{expected} for training on measurements; received"):
        model._check_stages(trainer)
    strategy.root_device, trainer.world_size = torch.device("cuda"), 1
    model._check_stages(trainer)


@pytest.mark.parametrize(("asked", "expected"), [("auto", "cpu"), ("gpu", "gpu")])
def test_measurements_use_the_cpu_unless_a_gpu_is_requested(asked, expected, monkeypatch):
    monkeypatch.setattr(torch.accelerator, "is_available", lambda: True)
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        given = ["experiment=pendulum_angles", f"trainer.accelerator={asked}", "folder=."]
        monkeypatch.setattr("ahnn.cli.prepare.factory", lambda node, *_: node)
        made: Any = factories_of(compose("train", given))
        assert made["trainer"].accelerator == expected


def test_a_step_of_an_ensemble_on_windows(tmp_path):
    data = data_module(SPRING, str(tmp_path), batch_size=20)
    models = [ready_model("mechanical", data, seed).dynamics for seed in range(2)]
    loader, objective = data.train_dataloader(), ready_model("mechanical", data).curriculum.judge
    batches, ends = [loader.gather(torch.arange(20) + 50 * k) for k in range(2)], []
    with simulated_device() as device:
        for place in (torch.device("cpu"), device):
            members = [copy.deepcopy(model).to(place) for model in models]
            own = [b._replace(start=b.start.to(place), increments=b.increments.to(place)) for b in batches]
            groups = [{"damping": 1.0, "tolerance": 0.3} for _ in members]
            objective.loss.to(place)
            losses = member_damped_steps(objective, members, own, groups)
            ends.append([losses.cpu(), *(parameters_to_vector(m.parameters()).cpu() for m in members)])
    for here, there in zip(*ends, strict=True):
        close(there, here, 1e-4)


@pytest.mark.parametrize("uncertain", [False, True])
def test_sampled_paths(uncertain):
    """Draws are those of the CPU, for starts alone and with parameters."""
    learned, lengths = dynamics(), torch.full((2, 3), 0.1, **DOUBLE)
    start, own = torch.tensor([[1.0, 0.2], [0.5, 0.1]], **DOUBLE), 0.1 * torch.eye(2, **DOUBLE)
    count = len(parameters_to_vector(learned.parameters()))
    spread = 0.01 * torch.randn(count, 3, generator=generator(1), **DOUBLE) if uncertain else None

    def last(learned, place):
        options = {"own": place(own), "common": None, "spread": None if spread is None else place(spread)}
        *_, states = sampled_paths(learned, drawn(place(start), 4, 0, **options), place(lengths))
        return states

    here = last(learned, lambda tensor: tensor)
    with simulated_device() as device:
        there = last(copy.deepcopy(learned).to(device), lambda tensor: tensor.to(device))
        assert there.device == device
        close(there.cpu(), here, 1e-12)
