"""On a GPU, where there is one, everything comes out as on the CPU."""

from __future__ import annotations

import pytest
import torch
from entry import SMALL, call
from helpers import close, generator

from ahnn.dynamics import HamiltonianDynamics
from ahnn.estimation import initial_belief
from ahnn.evaluation import load_results
from ahnn.measurements import Position
from ahnn.rollouts import rollout
from ahnn.training import FirstOrder, LevenbergMarquardt, LossOptions
from ahnn.training.cuda_graph import RecordedStep
from ahnn.training.loss import Loss
from ahnn.training.objectives import Derivative, Recursive
from ahnn.training.steppers import problems
from ahnn.types import Window
from ahnn_plugins.ukf import unscented_filter

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
KINDS = {
    "generic": {"hamiltonian": "generic", "integrator": {"name": "rk4"}},
    "separable": {"hamiltonian": "separable", "integrator": {"name": "leapfrog"}},
    "mechanical": {"hamiltonian": "mechanical", "inputs": "isotropic", "integrator": {"name": "rk4"}},
}


def dynamics(kind: str = "generic") -> HamiltonianDynamics:
    torch.manual_seed(0)
    known = {"inertia": 1.0, "mu": None, "inputs": "cartesian", "scaling": "block", **KINDS[kind]}
    network = {"width": 8, "depth": 2, "activation": "gelu"}
    return HamiltonianDynamics(2, network=network, **known).double()  # pyright: ignore[reportArgumentType]


def windows(seed: int, steps: int = 2) -> Window:
    rng = generator(seed)
    start = 1 + 0.3 * torch.randn(6, 4, generator=rng, dtype=torch.float64)
    return Window(start, 0.1 * torch.randn(6, steps, 4, generator=rng, dtype=torch.float64), 0.1)


def on_gpu(batch: Window) -> Window:
    return batch._replace(start=batch.start.cuda(), increments=batch.increments.cuda())


@pytest.mark.parametrize("kind", KINDS)
def test_recorded_steps_are_those_of_the_cpu(kind):
    """Replayed on other batches and weights than were recorded; later replays leave what was found alone."""
    here, there = dynamics(kind), dynamics(kind).cuda()
    loss, moved = Loss(4, LossOptions()).double(), Loss(4, LossOptions()).double().cuda()
    objective, recorded = Recursive(loss, 2), Recursive(moved, 2)
    stepper, kept = RecordedStep(6), []
    for seed in range(3):
        batch = windows(seed)
        here.zero_grad()
        there.zero_grad()
        value = FirstOrder().step(objective, loss, here, batch, None)
        found = stepper.step(recorded, moved, there, on_gpu(batch), None)
        value.backward()
        found.backward()
        kept.append((value, found))
        with torch.no_grad():
            for one, other in zip(here.parameters(), there.parameters(), strict=True):
                assert (one.grad is None) == (other.grad is None)
                if one.grad is not None and other.grad is not None:
                    close(other.grad.cpu(), one.grad, 1e-9)
                one.mul_(1.1)
                other.mul_(1.1)
    assert len(stepper.programs) == 1
    assert not stepper.failed
    for value, found in kept:
        close(found.cpu(), value, 1e-10)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("derivative", [False, True])
def test_a_second_order_step_is_that_of_the_cpu(kind, derivative):
    """The damping is large: Jacobians are of float32, whose rounding small eigenvalues would magnify."""
    ends = []
    for device in ("cpu", "cuda"):
        learned, loss = dynamics(kind).to(device), Loss(4, LossOptions()).double().to(device)
        objective = Derivative(loss, 4) if derivative else Recursive(loss, 4)
        batch = windows(0, 4) if device == "cpu" else on_gpu(windows(0, 4))
        optimizer = LevenbergMarquardt(learned.parameters(), damping=1.0)
        before = optimizer.step(lambda: problems(objective, learned, batch))  # noqa: B023
        ends.append((before.cpu(), torch.cat([p.detach().flatten().cpu() for p in learned.parameters()])))
    (loss_here, weights_here), (loss_there, weights_there) = ends
    close(loss_there, loss_here, 1e-10)
    close(weights_there, weights_here, 1e-4)
    start = torch.cat([p.detach().flatten() for p in dynamics(kind).parameters()])
    assert float((weights_here - start).norm()) > 1e-2


def test_rollouts_and_the_filter():
    start, measured = windows(0).start, torch.randn(6, 5, 2, generator=generator(1), dtype=torch.float64)
    covariance = 0.1 * torch.eye(4, dtype=torch.float64)
    ends = []
    for device in ("cpu", "cuda"):
        flow = dynamics().frozen().to(device)
        states = rollout(flow, start.to(device), 0.1, 20)
        belief = initial_belief(start.to(device), covariance.to(device))
        noise = (0.01 * covariance, 0.1 * torch.eye(2, dtype=torch.float64))
        result = unscented_filter(
            flow,
            belief,
            measured.to(device),
            Position(2),
            *(n.to(device) for n in noise),
            0.1,
        )
        ends.append((states, result.means, result.covariances, result.log_likelihood))
    for here, there in zip(*ends, strict=True):
        assert there.is_cuda
        close(there.cpu(), here, 1e-9)


GPU = ["trainer.accelerator=gpu", "data.precision=64"]


@pytest.mark.parametrize("recipe", ["first_order", "second_order"])
def test_a_training_ends_as_on_the_cpu(recipe, tmp_path):
    """A few steps: rounding grows with their number."""
    scores = []
    for name, device in (("cpu", ["data.precision=64"]), ("gpu", GPU)):
        run = [f"recipe={recipe}", *SMALL, *device, "trainer.max_epochs=1", f"run={tmp_path / name}"]
        assert call("ahnn.train", *run) == 0
        scores.append(load_results(tmp_path / name).rows[0].scores.position)
    assert scores[1] == pytest.approx(scores[0], rel=1e-3)


def test_a_lost_loss_ends_a_training(tmp_path, capsys):
    """Though the host looks at losses and gradients now and then."""
    lost = ["recipe=first_order", *SMALL, *GPU, "optimizer.lr=1e18", "data.windows_per_epoch=1600"]
    assert call("ahnn.train", *lost, f"run={tmp_path}") == 3
    assert "the last good checkpoint is kept" in capsys.readouterr().err


MEASURED = [
    "budget=smoke",
    "plugins=none",
    "logger=none",
    "trainer.max_epochs=2",
    "data.trajectories=40",
    "data.windows_per_epoch=600",
    "model.network.width=8",
]
"""Overrides of a short training on measurements."""
LEARNED = {
    "shooting": ["experiment=pendulum_angles", "loss.stages=[[4,0.5],[16,1.0]]"],
    "robust": ["experiment=pendulum_angles", "loss.stages=[[4,0.5],[16,1.0]]", "loss.robust=student"],
    "weak form": ["experiment=spring_noisy", "loss.stages=[[relative,0.5],[weak,1.0]]"],
    "gradients": ["experiment=pendulum_angles", "loss.stages=[[4,0.5],[16,1.0]]", "optimizer=adamw"],
    "members": ["experiment=pendulum_angles", "loss.stages=[[4,0.5],[16,1.0]]", "members=2"],
}


@pytest.mark.parametrize("what", LEARNED)
def test_measurements_are_learned_from_as_on_the_cpu(what, tmp_path):
    """Equal validation losses and chi-square within a few per cent: rounding grows over the steps."""
    found = []
    for device in ("cpu", "gpu"):
        run = [*LEARNED[what], *MEASURED, f"trainer.accelerator={device}", f"run={tmp_path / device}"]
        assert call("ahnn.train", *run) == 0
        folders = sorted(path.parent for path in (tmp_path / device).rglob("metrics.json"))
        results = [load_results(folder) for folder in folders]
        found.append([one.training["val_loss"] for one in results])
        found[-1] += [one.numbers["measurements"]["chi_square"] for one in results]
    here, there = found
    assert len(here) == len(there) >= 2
    assert there == pytest.approx(here, rel=0.05)


def test_measurements_are_learned_from_on_the_cpu_by_default(tmp_path):
    assert call("ahnn.train", *LEARNED["shooting"], *MEASURED, f"run={tmp_path}") == 0
