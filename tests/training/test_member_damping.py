"""Second-order steps of members at once, beside those of each member alone."""

from __future__ import annotations

import copy

import pytest
import torch
from helpers import SPRING, close, data_module, ready_model

from ahnn.training import Derivative, LevenbergMarquardt
from ahnn.training.member_damping import joined, member_damped_steps
from ahnn.training.member_equations import member_equations
from ahnn.training.steppers import problems

COUNT = 3
KINDS = {"generic": "hnn", "two blocks": "separable", "known kinetic energy": "mechanical", "field": "node"}


@pytest.fixture
def made(request, tmp_path):
    data = data_module(SPRING, str(tmp_path), batch_size=40)
    models = [ready_model(request.param, data, seed) for seed in range(COUNT)]
    windows = data.train_dataloader()
    batches = [windows.gather(torch.arange(40) + 50 * k) for k in range(COUNT)]
    return models, batches


def objectives(model):
    return {"predictions": model.curriculum.judge, "derivatives": Derivative(model.loss, 2)}


@pytest.mark.parametrize("what", ["predictions", "derivatives"])
@pytest.mark.parametrize("made", KINDS.values(), ids=KINDS, indirect=True)
def test_equations_are_those_of_each_member_alone(made, what):
    models, batches = made
    found = objectives(models[0])[what]
    sizes = [p.numel() for p in models[0].dynamics.parameters()]
    thetas = torch.stack(
        [torch.nn.utils.parameters_to_vector(m.dynamics.parameters()).detach() for m in models]
    )
    with torch.no_grad():
        at_once = member_equations(found, [m.dynamics for m in models], thetas, joined(batches), sizes)
    for k, (model, batch) in enumerate(zip(models, batches, strict=True)):
        alone = objectives(model)[what].problem(model.dynamics, batch).equations(thetas[k], sizes)
        assert at_once.degrees == alone.degrees
        close(at_once.loss[k], alone.loss, 1e-9)
        assert len(at_once.blocks) == len(alone.blocks)
        for mine, other in zip(at_once.blocks, alone.blocks, strict=True):
            assert torch.equal(mine.columns, other.columns)
            close(mine.matrix[k], other.matrix, 1e-5)
            close(mine.gradient[k], other.gradient, 1e-4)


@pytest.mark.parametrize("made", ["hnn"], indirect=True)
@pytest.mark.parametrize(("damping", "accuracy"), [(1e-2, 1e-4), (1e-12, 1e-2)])  # rows are in float32
def test_steps_and_dampings_are_those_of_each_member_alone(made, damping, accuracy):
    models, batches = made
    alone = copy.deepcopy(models)
    optimizers = [LevenbergMarquardt(m.dynamics.parameters(), damping * 10**k) for k, m in enumerate(models)]
    singly = [LevenbergMarquardt(m.dynamics.parameters(), damping * 10**k) for k, m in enumerate(alone)]
    objective, before = models[0].curriculum.judge, [p.clone() for p in models[0].dynamics.parameters()]
    for _ in range(3):
        groups = [one.param_groups[0] for one in optimizers]
        means = member_damped_steps(objective, [m.dynamics for m in models], batches, groups)
        for k, (model, batch, optimizer) in enumerate(zip(alone, batches, singly, strict=True)):
            wanted = optimizer.step(lambda m=model, b=batch: problems(m.curriculum.judge, m.dynamics, b))
            close(means[k], wanted, accuracy)
            assert groups[k]["damping"] == pytest.approx(optimizer.param_groups[0]["damping"], rel=1e-9)
            assert groups[k]["gradient_norm"] == pytest.approx(
                optimizer.param_groups[0]["gradient_norm"], rel=1e-3
            )
    for model, other in zip(models, alone, strict=True):
        for mine, theirs in zip(model.dynamics.parameters(), other.dynamics.parameters(), strict=True):
            assert damping < 1e-2 or float((mine - theirs).detach().abs().max()) <= accuracy
    after = models[0].dynamics.parameters()
    moved = [float((a - b).detach().abs().max()) for a, b in zip(before, after, strict=True)]
    assert (max(moved) > 1e-3) == (damping == 1e-2)  # hardly damped, every step is rejected
