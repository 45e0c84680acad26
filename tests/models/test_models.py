"""Every model trains, hands out its flow, and survives Lightning's evaluation modes and checkpoints."""

from __future__ import annotations

import math

import lightning
import pytest
import torch
from helpers import MOLNIYA, SPRING, batch_of, close, data_module, defaults, ready_model

from ahnn.checkpoints import read_weights
from ahnn.cli.preflight import quiet
from ahnn.dynamics import Dynamics
from ahnn.dynamics.base import require_step
from ahnn.errors import UserError
from ahnn.loading import made
from ahnn.models import AHNN, MLP, NODE, AbstractModel

NAMES = [
    "mlp",
    "mlp_residual",
    "node",
    "generic",
    "separable",
    "mechanical",
    "central_body",
    "hnn_derivative",
]


@pytest.mark.parametrize("system", [SPRING, MOLNIYA], ids=["spring", "molniya"])
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.sampled(3)
def test_a_model_fits_a_tiny_batch(cache, name, system):
    if name == "central_body" and system is SPRING:
        pytest.skip("one degree of freedom has no centre")
    data = data_module(system, cache, window=2, precision=32)
    model, batch = ready_model(name, data), batch_of(data)
    optimizer = torch.optim.AdamW(model.parameters(), lr=1e-2)
    losses = []
    for _ in range(60):
        loss = model.loss(model.objective.residuals(model.dynamics, batch))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert math.isfinite(losses[-1])
    assert losses[-1] < 0.5 * losses[0]


@pytest.mark.parametrize("name", NAMES)
def test_the_flow_is_a_float64_copy_that_shares_no_memory(cache, name):
    system = MOLNIYA if name == "central_body" else SPRING
    data = data_module(system, cache, precision=32)
    model = ready_model(name, data)
    flow = model.flow()
    x = data.trajectories("test").states[:, 0]
    before = flow(x, system.dt)
    assert before.dtype == torch.float64
    assert not before.requires_grad
    close(before, model(x.float(), system.dt), 1e-5)
    with torch.no_grad():
        for tensor in (*model.parameters(), *model.buffers()):
            tensor.fill_(0.5)
    assert torch.equal(flow(x, system.dt), before)


def test_an_mlp_refuses_any_other_time_step(cache):
    data = data_module(SPRING, cache)
    flow = ready_model("mlp", data).flow()
    x = data.trajectories("test").states[:, 0]
    for dt in (0.02, torch.tensor([0.01, 0.02], dtype=torch.float64)):
        with pytest.raises(UserError, match=r"used in training, 0.01; received"):
            flow(x, dt)
    same = torch.full((len(x),), 0.01, dtype=torch.float64)
    assert torch.equal(flow(x, same), flow(x, 0.01))


@pytest.mark.parametrize("step", [1e-4, 1.0, 60.0])
def test_the_step_of_a_map_is_known_to_a_millionth(step):
    """Whatever its unit; of many steps each is."""
    for dt in (step, step * (1 + 5e-7), torch.tensor([step, step * (1 - 5e-7)]).double()):
        require_step(step, dt)
    for off in (1 + 2e-6, 1 - 2e-6, math.nan):
        for dt in (off * step, torch.tensor([step, off * step]).double()):
            with pytest.raises(UserError, match="used in training"):
                require_step(step, dt)


def test_an_mlp_has_no_derivative_loss(cache):
    with pytest.raises(UserError, match="derivative"):
        ready_model("mlp", data_module(SPRING, cache), loss={"derivative": 1.0})


@pytest.mark.parametrize("name", ["node", "generic"])
def test_a_field_takes_a_step_for_each_member(cache, name):
    data = data_module(SPRING, cache)
    flow = ready_model(name, data).flow()
    x = data.trajectories("test").states[:, 0]
    steps = torch.tensor([0.01, 0.03], dtype=torch.float64)
    one_by_one = torch.cat([flow(x[b : b + 1], float(steps[b])) for b in range(2)])
    close(flow(x, steps), one_by_one, 1e-14)


@pytest.mark.parametrize("structure", ["separable", "mechanical"])
def test_a_separable_model_runs_through_a_composition(cache, structure):
    data = data_module(SPRING, cache)
    model = ready_model(structure, data, integrator={"name": "yoshida4"})
    assert bool(model.objective.residuals(model.dynamics, batch_of(data)).isfinite().all())


def test_a_wrong_option_of_a_loss_is_named(cache):
    with pytest.raises(UserError, match="loss: unknown key 'delat'; did you mean 'delta'"):
        ready_model("generic", data_module(SPRING, cache), loss={"delat": 1.0})


def trainer(folder, **options):
    quiet()
    defaults = {"logger": False, "enable_progress_bar": False, "enable_model_summary": False}
    defaults |= {"accelerator": "cpu", "num_sanity_val_steps": 0, "max_epochs": 1}
    return lightning.Trainer(default_root_dir=folder, **(defaults | options))


@pytest.mark.parametrize("name", ["mlp", "node", "generic", "hnn_derivative"])
def test_lightning_trains_validates_tests_and_predicts(cache, tmp_path, name):
    data = data_module(SPRING, cache, precision=32)
    model = ready_model(name, data)
    model.test_step = model.validation_step
    model.predict_step = lambda batch: model(batch.start, batch.dt)
    run = trainer(tmp_path, enable_checkpointing=False)
    run.fit(model, data)
    loader = data.val_dataloader()
    run.validate(model, loader, verbose=False)
    validated = float(run.callback_metrics["val/loss"])
    run.test(model, loader, verbose=False)
    assert float(run.callback_metrics["val/loss"]) == validated
    assert math.isfinite(validated)
    predictions = run.predict(model, loader)
    assert len(predictions) == len(loader)


@pytest.mark.parametrize("name", ["mlp", "node", "generic", "mechanical", "central_body"])
def test_a_checkpoint_is_plain_and_restores_the_model(cache, tmp_path, name):
    system = MOLNIYA if name == "central_body" else SPRING
    data = data_module(system, cache, precision=32)
    model = ready_model(name, data)
    run = trainer(tmp_path)
    run.fit(model, data)
    path = tmp_path / "model.ckpt"
    run.save_checkpoint(path)
    content = torch.load(path, weights_only=True)
    assert content["ahnn"]["space"]["name"] == system.name
    restored = type(model).load_from_checkpoint(path, map_location="cpu", weights_only=True)
    assert isinstance(restored, AHNN | MLP | NODE)
    x = data.trajectories("test").states[:, 0]
    assert torch.equal(restored(x.float(), system.dt), model(x.float(), system.dt))
    loaded = made(read_weights(path), tmp_path)
    assert torch.equal(loaded.flow(x), model.flow()(x, system.dt))
    assert loaded.space == system.space


def test_dynamics_without_a_field_have_no_loss_on_derivatives():
    class Shear(Dynamics):
        def fit(self, statistics):
            pass

        def increment(self, x, dt):
            return dt * x

    class Plugin(AbstractModel):
        pass

    with pytest.raises(UserError, match=r"loss=recursive, .* has no field; received {'derivative': 0.8}"):
        Plugin(Shear(), 1, 3, defaults("ahnn")["loss"] | {"derivative": 0.8})
