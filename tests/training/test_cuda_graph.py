"""Recorded steps: the graph holds what autograd finds, failures leave a training to autograd.

The traced graph stands for the recording that a GPU makes of it (tests/test_gpu.py).
"""

from __future__ import annotations

import logging
from types import SimpleNamespace

import pytest
import torch
from helpers import close

from ahnn.dynamics import HamiltonianDynamics, make_dynamics
from ahnn.training import FirstOrder, LossOptions
from ahnn.training.cuda_graph import Program, RecordedStep, can_record
from ahnn.training.loss import Loss
from ahnn.training.objectives import Derivative, Recursive
from ahnn.types import Window

GENERIC = {"hamiltonian": "generic", "inertia": 1.0, "mu": None, "inputs": "cartesian", "scaling": "block"}


def hamiltonian(dtype: torch.dtype, activation: str = "tanh", integrator: str = "midpoint", **options):
    torch.manual_seed(0)
    network = {"width": 8, "depth": 2, "activation": activation}
    known = {**GENERIC, "network": network, "integrator": {"name": integrator}, **options}
    return HamiltonianDynamics(2, **known).to(dtype)  # pyright: ignore[reportArgumentType]


def windows(dtype: torch.dtype, steps: int = 2, uneven: bool = False) -> Window:
    generator = torch.Generator().manual_seed(1)
    start = torch.randn(6, 4, generator=generator, dtype=torch.float64)
    increments = torch.randn(6, steps, 4, generator=generator, dtype=torch.float64)
    dt = torch.rand(6, steps, generator=generator, dtype=torch.float64).to(dtype) if uneven else 0.1
    return Window(start.to(dtype), increments.to(dtype), dt)


def gradients(stepper, objective, loss, dynamics, batch):
    dynamics.zero_grad()
    value = stepper.step(objective, loss, dynamics, batch, None)
    (3 * value).backward()
    return value, [p.grad for p in dynamics.parameters()]


def interpreted(graph):
    """In place of a recording: the graph itself."""
    return Program(graph.graph, graph.touched)


def assert_agree(stepper, objective, loss, dynamics, batch, rtol: float) -> None:
    value, found = gradients(stepper, objective, loss, dynamics, batch)
    expected, wanted = gradients(FirstOrder(), objective, loss, dynamics, batch)
    close(value, expected, rtol)
    assert [g is None for g in found] == [g is None for g in wanted]
    for one, other in zip(found, wanted, strict=True):
        if other is not None:
            close(one, other, rtol)


DYNAMICS = {
    "written out, gelu": {"activation": "gelu"},
    "written out, sine": {"activation": "sine"},
    "separable, symplectic": {"hamiltonian": "separable", "integrator": "leapfrog"},
    "central body": {"hamiltonian": "central_body", "inputs": "isotropic", "integrator": "leapfrog"},
}


@pytest.mark.parametrize(
    ("name", "uneven"), [*((name, False) for name in DYNAMICS), ("written out, gelu", True)]
)
def test_the_traced_step_is_that_of_autograd(name, uneven):
    dynamics, loss = hamiltonian(torch.float64, **DYNAMICS[name]), Loss(4, LossOptions(delta=0.5)).double()
    stepper, objective = RecordedStep(6, interpreted), Recursive(loss, 2)
    batch = windows(torch.float64, uneven=uneven)
    assert_agree(stepper, objective, loss, dynamics, batch, 1e-12)
    with torch.no_grad():  # weights, windows and the unit of the loss are no constants of the graph
        for tensor in (*dynamics.parameters(), batch.start, batch.increments, loss.unit):
            tensor.mul_(1.3)
    assert_agree(stepper, objective, loss, dynamics, batch._replace(weight=0.75), 1e-12)
    assert len(stepper.programs) == 1
    assert not stepper.failed


def test_other_dynamics_and_objectives():
    loss = Loss(4, LossOptions(balance=0.5)).double()
    network = {"width": 8, "depth": 2, "activation": "silu"}
    node = make_dynamics(
        "node", dof=2, scaling="block", network=network, integrator={"name": "euler"}
    ).double()
    stepper = RecordedStep(6, interpreted)
    assert_agree(stepper, Recursive(loss, 3), loss, node, windows(torch.float64, 3), 1e-12)
    assert_agree(stepper, Derivative(loss, 4), loss, node, windows(torch.float64, 4), 1e-12)
    assert len(stepper.programs) == 2


def test_batches_of_another_size_are_left_to_autograd():
    dynamics, loss = hamiltonian(torch.float64), Loss(4, LossOptions()).double()
    stepper = RecordedStep(7, interpreted)
    assert_agree(stepper, Recursive(loss, 2), loss, dynamics, windows(torch.float64), 0.0)
    assert not stepper.programs


def test_a_recording_that_fails_leaves_the_training_to_autograd(caplog):
    def fails(_):
        message = "operation not permitted when stream is capturing"
        raise RuntimeError(message)

    dynamics, loss = hamiltonian(torch.float64, integrator="euler"), Loss(4, LossOptions()).double()
    stepper, objective = RecordedStep(6, fails), Recursive(loss, 1)
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            assert_agree(stepper, objective, loss, dynamics, windows(torch.float64), 0.0)
    assert stepper.failed
    assert len(caplog.records) == 1
    assert "cuda_graphs: expected optimiser steps that can be recorded" in caplog.text


RECORDED = {
    "device": "cuda",
    "world_size": 1,
    "precision": "32-true",
    "automatic": True,
    "integrator": "midpoint",
}
OTHERS = {"device": "cpu", "world_size": 2, "precision": "64-true", "automatic": False, "integrator": "gl4"}


@pytest.mark.parametrize("other", [None, *OTHERS])
def test_steps_are_recorded_where_they_are_always_the_same_on_one_gpu(other):
    known = RECORDED | ({} if other is None else {other: OTHERS[other]})
    phase = SimpleNamespace(objective=Recursive(Loss(4, LossOptions()), 1))
    model = SimpleNamespace(
        dynamics=hamiltonian(torch.float32, integrator=known["integrator"]),
        curriculum=SimpleNamespace(phases=[phase]),
        automatic_optimization=known["automatic"],
    )
    strategy = SimpleNamespace(root_device=torch.device(known["device"]))
    trainer = SimpleNamespace(strategy=strategy, world_size=known["world_size"], precision=known["precision"])
    assert can_record(trainer, model) == (other is None)
