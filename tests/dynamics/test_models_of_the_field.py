"""SympNet, HénonNet, GHNN and the Lagrangian network: what each is by construction, and that each learns."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from entry import SMALL, call
from helpers import close, generator
from torch.func import jacrev, vmap

import ahnn
from ahnn.dynamics import make_dynamics
from ahnn.errors import UserError
from ahnn.evaluation import load_results
from ahnn.graphs.modules import modules
from ahnn.statistics import Statistics
from ahnn.types import Space, Trajectories

DOUBLE = {"dtype": torch.float64}
NETWORK = {"width": 9, "depth": 2, "activation": "tanh"}
MAPS = {
    "sympnet": {"form": "G", "layers": 3},
    "sympnet_la": {"form": "LA", "layers": 2, "shears": 3},
    "henon_net": {"layers": 2},
    "generalised_hnn": {"layers": 2},
}


def data(dof=2):
    """Trajectories whose positions and momenta have scales and middles of their own."""
    x = torch.randn(6, 40, 2 * dof, generator=generator(0), **DOUBLE).cumsum(1)
    x = x * torch.tensor([3.0] * dof + [0.2] * dof, **DOUBLE) + 0.7
    return Trajectories(x, 0.1 * torch.arange(40.0, **DOUBLE).expand(6, -1))


def made(name, dof=2, **changes):
    torch.manual_seed(0)
    options = MAPS[name] | {"scaling": "block", "network": NETWORK} | changes
    dynamics = make_dynamics(name.removesuffix("_la"), dof=dof, **options).double()
    for parameter in dynamics.parameters():
        parameter.data += 0.3 * torch.randn(parameter.shape, generator=generator(1), **DOUBLE)
    dynamics.fit(Statistics.of(data(dof)))
    return dynamics.requires_grad_(False)


@pytest.mark.parametrize("dof", [1, 2, 3])
@pytest.mark.parametrize("name", MAPS)
def test_a_step_is_symplectic_in_the_units_of_the_data_whatever_the_weights(name, dof):
    model, x = made(name, dof), data(dof).states[:, 5]
    jacobian = vmap(jacrev(lambda one: model(one[None], 0.1)[0]))(x)
    one, nothing = torch.eye(dof, **DOUBLE), torch.zeros(dof, dof, **DOUBLE)
    form = torch.cat((torch.cat((nothing, one), 1), torch.cat((-one, nothing), 1)))
    close(jacobian.mT @ form @ jacobian, form.expand(6, -1, -1), 1e-10)
    assert float((jacobian - torch.eye(2 * dof, **DOUBLE)).abs().max()) > 0.1


def test_a_layer_of_a_henon_net_is_four_henon_maps():
    layer = made("henon_net").layers[0]
    layer.shift.data = torch.tensor([0.4, -0.9], **DOUBLE)
    q, p = torch.randn(2, 5, 2, generator=generator(2), **DOUBLE)
    x, y = q, p
    for _ in range(4):
        x, y = y + layer.shift, -x + layer.potential.gradient(y)
    moved_q, moved_p = layer(q, p)
    close(q + moved_q, x, 1e-13)
    close(p + moved_p, y, 1e-13)


def test_a_gradient_module_is_that_of_the_paper():
    """P + K^T diag(a) sigma(K q + b), with sigma the slope of the activation."""
    shear = made("sympnet").layers[0]
    q = torch.randn(5, 2, generator=generator(2), **DOUBLE)
    (hidden,), a = shear.network.hidden, shear.network.output.weight[0]
    sigma = 1 - torch.tanh(q @ hidden.weight.T + hidden.bias) ** 2
    close(shear(q, q)[1], -(a * sigma) @ hidden.weight, 1e-13)


@pytest.mark.parametrize("name", MAPS)
def test_a_map_has_one_step(name):
    with pytest.raises(UserError, match=r"model: expected the step used in training, 0.1; received 0.2"):
        made(name)(data().states[:, 0], 0.2)


@pytest.mark.parametrize("masses", [[1.5], [1.5, 4.0], [1.5, 4.0, 0.7]], ids=len)
def test_a_lagrangian_field_solves_the_euler_lagrange_equations(masses):
    torch.manual_seed(0)
    dof, options = len(masses), {"scaling": "minmax", "network": NETWORK, "integrator": {"name": "rk4"}}
    model = make_dynamics("lagrangian", dof=dof, inertia=masses, **options).double()
    model.requires_grad_(False)
    model.fit(Statistics.of(data(dof)))
    field, x = model.field, data(dof).states[:, 5]
    m = field.inertia

    def lagrangian(q, v):
        z = field.seen(torch.cat((q, m * v), dim=-1))
        return 0.5 * (m * v * v).sum(-1) + field.unit * field.network(z)[..., 0]

    q, v = x[:, :dof].clone(), (x[:, dof:] / m).clone()
    rate = field(x)
    close(rate[:, :dof], v, 1e-13)
    a = rate[:, dof:] / m
    of_q, of_v = vmap(jacrev(jacrev(lagrangian, argnums=1), argnums=(0, 1)))(q, v)
    along = (of_q @ v.unsqueeze(-1) + of_v @ a.unsqueeze(-1)).squeeze(-1)
    close(along, vmap(jacrev(lagrangian, argnums=0))(q, v), 1e-10)
    assert float((a * m - x[:, dof:]).abs().max()) > 1e-3


@pytest.mark.parametrize("model", ["sympnet", "sympnet model.form=LA", "henon_net", "ghnn", "lnn", "srnn"])
@pytest.mark.sampled(2)
def test_each_trains_is_judged_and_is_loaded_again(model, tmp_path):
    words = [f"model={model.split()[0]}", *model.split()[1:], f"run={tmp_path / 'run'}"]
    small = [*SMALL, "evaluation=scores", "data.batch_size=80"]
    if model == "srnn":  # a fiftieth of a batch makes a step over ten predictions
        small += ["data.batch_size=1000", "data.windows_per_epoch=4000"]
    assert call("ahnn.train", *words, *small, "recipe=second_order", "trainer.max_epochs=6") == 0
    (row,) = [r for r in load_results(tmp_path / "run").rows if not r.who.floor and r.who.start == "true"]
    assert row.scores.position < 0.2  # 0.28 without training
    run = ahnn.load(tmp_path / "run")
    assert run.rollout([0.5, 0.0], 3).isfinite().all()


def test_a_map_does_not_fit_derivatives(tmp_path, capsys):
    assert call("ahnn.train", "model=sympnet", "loss=derivative", f"run={tmp_path / 'run'}", *SMALL) == 2
    assert "expected loss=recursive, since a map has no field" in capsys.readouterr().err


@pytest.mark.parametrize("name", MAPS)
def test_a_map_carries_the_covariance_of_a_start(name):
    model, start = made(name), data().states[:1, 5]
    space = Space("made", ("q1", "q2", "p1", "p2"))
    run = ahnn.Run(model.frozen(), space, 0.1, {}, Path())
    found = run.predict(start, [0.0, 0.1], start_covariance=torch.eye(4, **DOUBLE))
    moved = jacrev(lambda one: model(one[None], 0.1)[0])(start[0])
    assert found.covariances is not None
    close(found.covariances[0, 1], moved @ moved.T, 1e-5)


def test_a_gradient_form_has_no_shears_and_a_lagrangian_no_graph():
    with pytest.raises(UserError, match="shears: expected none with form=G"):
        made("sympnet", shears=3)
    options = {"inertia": 1.0, "scaling": "none", "network": NETWORK, "integrator": {"name": "rk4"}}
    with pytest.raises(
        UserError, match="export: expected dynamics that can be exported as a graph; received a Lagr"
    ):
        modules(make_dynamics("lagrangian", dof=1, **options), 0.1)


@pytest.mark.parametrize("name", MAPS)
def test_layers_that_would_never_be_made_are_refused(name):
    key = "shears" if name == "sympnet_la" else "layers"
    with pytest.raises(UserError, match=f"{key}: expected int from 1 to 1000"):
        made(name, **{key: 10**12})


@pytest.mark.parametrize("inertia", [float("nan"), 0.0, [1.0], [1.0, float("inf")]])
def test_a_mass_of_a_lagrangian_that_is_none_is_refused(inertia):
    options = {"scaling": "none", "network": NETWORK, "integrator": {"name": "rk4"}}
    with pytest.raises(UserError, match="inertia: expected"):
        make_dynamics("lagrangian", dof=2, inertia=inertia, **options)
