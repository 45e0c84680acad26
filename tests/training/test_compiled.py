"""Compiled steps: the graph holds what autograd finds, failures leave a training to autograd, resumes agree.

Only one slow test compiles; in the others the traced graph stands for the code that is made of it.
"""

from __future__ import annotations

import logging
import os
from functools import partial
from types import SimpleNamespace

import pytest
import torch
from entry import SMALL, Interrupted, call
from helpers import close

from ahnn.checkpoints import read_checkpoint
from ahnn.dynamics import HamiltonianDynamics, make_dynamics
from ahnn.training import FirstOrder, LossOptions, compilation, payback
from ahnn.training.compilation import Program, compiled, kept_in
from ahnn.training.compiled import Compiled
from ahnn.training.loss import Loss
from ahnn.training.objectives import Derivative, Recursive
from ahnn.training.replayed import replayed
from ahnn.training.tracing import Compared, traced
from ahnn.types import Window

FIRST = ["recipe=first_order", "integrator=euler", "window=1", *SMALL]
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


def interpreted(graph, cache=None):
    """In place of a compilation: the graph itself."""
    del cache
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
    stepper, objective = Compiled(6, interpreted), Recursive(loss, 2)
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
    stepper = Compiled(6, interpreted)
    assert_agree(stepper, Recursive(loss, 3), loss, node, windows(torch.float64, 3), 1e-12)
    assert_agree(stepper, Derivative(loss, 4), loss, node, windows(torch.float64, 4), 1e-12)
    assert len(stepper.programs) == 2


def test_batches_of_another_size_are_left_to_autograd():
    dynamics, loss = hamiltonian(torch.float64), Loss(4, LossOptions()).double()
    stepper = Compiled(7, interpreted)
    assert_agree(stepper, Recursive(loss, 2), loss, dynamics, windows(torch.float64), 0.0)
    assert not stepper.programs


def test_without_a_compiler_a_training_goes_on(monkeypatch, tmp_path, caplog):
    """Torch looks for a compiler on the path: on an empty one there is none."""
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CXX", raising=False)
    dynamics, loss = hamiltonian(torch.float64, integrator="euler"), Loss(4, LossOptions()).double()
    monkeypatch.setattr("torch._inductor.config.cpp.cxx", (None, str(tmp_path / "g++")))
    stepper, objective = Compiled(6, partial(compiled, cache=tmp_path)), Recursive(loss, 1)
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            assert_agree(stepper, objective, loss, dynamics, windows(torch.float64), 0.0)
    assert stepper.failed
    assert len(caplog.records) == 1
    assert "install g++, or set compile=false" in caplog.text


def test_compiled_code_is_kept_where_nobody_else_writes(monkeypatch, tmp_path):
    monkeypatch.delenv(compilation.PLACE, raising=False)
    with kept_in(tmp_path / "own"):
        assert os.environ[compilation.PLACE] == str(tmp_path / "own")
    assert compilation.PLACE not in os.environ
    assert (tmp_path / "own").stat().st_mode & 0o077 == 0
    for mode in (0o777, 0o720, 0o702):
        (tmp_path / "own").chmod(mode)
        with pytest.raises(PermissionError, match="others can write"), kept_in(tmp_path / "own"):
            pass
    (tmp_path / "own").chmod(0o755)
    with kept_in(tmp_path / "own"):
        assert os.environ[compilation.PLACE] == str(tmp_path / "own")


def test_prices_are_those_measured_here(monkeypatch, tmp_path):
    monkeypatch.delenv(compilation.PLACE, raising=False)
    loss = Loss(4, LossOptions()).double()
    graphs = [
        traced(Compared(Recursive(loss, w), loss, hamiltonian(torch.float64)), windows(torch.float64, w))
        for w in (1, 2)
    ]
    count = len(graphs[1].graph.graph.nodes)
    assert compilation.price(graphs[1], tmp_path) == pytest.approx(count * compilation.PER_NODE)
    compilation.record(graphs[0], tmp_path).parent.mkdir(parents=True)
    compilation.record(graphs[0], tmp_path).write_text("0.5")
    assert compilation.price(graphs[0], tmp_path) == compilation.RELOAD
    assert compilation.price(graphs[1], tmp_path) == pytest.approx(count * 0.5)
    compilation.record(graphs[0], tmp_path).write_text("{")
    assert compilation.price(graphs[1], tmp_path) == pytest.approx(count * compilation.PER_NODE)
    for said, taken in (("-1", 0.0), ("0.25", 0.25), ("9.9", 9.9), ("1e9", 10.0)):
        compilation.record(graphs[0], tmp_path).write_text(said)
        assert compilation.price(graphs[1], tmp_path) == pytest.approx(count * taken)
    others = compilation.record(graphs[0], tmp_path).parent
    for name, said in zip("abcd", ("0.3", "0.1", "7", "0.2"), strict=True):
        (others / f"{name}.json").write_text(said)
    assert compilation.price(graphs[1], tmp_path) == pytest.approx(count * 0.3)  # the middle of five


def chosen(monkeypatch, asked, cost: float = 0.0, device: str = "cpu", before: bool | None = None):
    """The model, and what is said, of a training of 1,000 steps of 1 s that compiles at such a price."""
    objective = Recursive(Loss(4, LossOptions()), 1)
    curriculum = SimpleNamespace(phases=[SimpleNamespace(objective=objective)], at=lambda *_: objective)
    dynamics = hamiltonian(torch.float32)
    model = SimpleNamespace(
        dynamics=dynamics, curriculum=curriculum, automatic_optimization=True, compiled=None, about={}
    )
    strategy = SimpleNamespace(root_device=torch.device(device))
    trainer = SimpleNamespace(strategy=strategy, world_size=1, precision="32-true", max_epochs=10)
    loader = type("Loader", (), {"__len__": lambda _: 100, "batches": lambda _: [torch.arange(16)]})()
    monkeypatch.setattr(payback, "step_seconds", lambda *_: 1.0)
    monkeypatch.setattr(payback, "_price", lambda *_: cost)
    said: list[str] = []
    monkeypatch.setattr(payback.log, "info", lambda text, *values: said.append(text % values))
    data = SimpleNamespace(train_dataloader=lambda: loader)
    payback.choose(asked, trainer, data, model, "/nowhere", before)  # pyright: ignore[reportArgumentType]
    return model, said


def announced(cost: float, monkeypatch) -> tuple[bool, list[str]]:
    """Whether such a training compiles, and what is said."""
    model, said = chosen(monkeypatch, "auto", cost)
    assert model.about["compiled"] == (model.compiled is not None)
    return model.about["compiled"], said


@pytest.mark.parametrize("before", [None, True, False])
@pytest.mark.parametrize("asked", ["auto", False])
def test_on_a_gpu_steps_are_recorded_unless_they_shall_not(asked, before, monkeypatch):
    model, said = chosen(monkeypatch, asked, device="cuda", before=before)
    assert not model.about["compiled"]
    assert not said
    assert (model.compiled.make is replayed) if asked else (model.compiled is None)


@pytest.mark.parametrize(("in_c", "saved"), [(False, 400), (True, 100)])
def test_auto_compiles_where_it_pays_back(in_c, saved, monkeypatch):
    monkeypatch.setattr(HamiltonianDynamics, "in_c", lambda _: in_c)
    told = f"compile: auto compiles the optimiser steps: about {saved - 1} s of compilation, "
    assert announced(saved - 1, monkeypatch) == (True, [f"{told}about {saved} s saved"])
    compiles, said = announced(saved + 1, monkeypatch)
    assert not compiles
    assert "does not compile" in said[0]
    monkeypatch.setattr(payback, "WORTH", saved + 1)
    assert announced(0.0, monkeypatch) == (False, [])  # a short training tries and says nothing


def test_a_cut_training_ends_with_the_same_bits(monkeypatch, tmp_path):
    """Under auto a resumed training takes compiled steps as the first did, though they pay back no more."""
    monkeypatch.setattr(payback, "compiled", interpreted)
    monkeypatch.setattr("ahnn.train.judge", lambda *_, **__: 0.0)
    steps = []
    monkeypatch.setattr(Compiled, "_program", counting(Compiled._program, steps))
    options = [*FIRST, "callbacks.last.every=4"]
    with monkeypatch.context() as patch:
        patch.setattr(payback, "WORTH", 0.0)
        patch.setattr(payback, "_price", lambda *_: -1.0)
        assert call("ahnn.train", *options, f"run={tmp_path / 'whole'}") == 0
        assert len(steps) >= 30
        cut = ["+callbacks.cut._target_=entry.CutAfter", "+callbacks.cut.steps=15", f"run={tmp_path / 'cut'}"]
        with pytest.raises(Interrupted):
            call("ahnn.train", *options, *cut)
    assert call("ahnn.train", *options, f"run={tmp_path / 'cut'}", "ckpt=last") == 0
    one, other = (read_checkpoint(tmp_path / d / "checkpoints" / "last.ckpt") for d in ("whole", "cut"))
    assert one["ahnn"]["compiled"] is other["ahnn"]["compiled"] is True
    assert all(torch.equal(one["state_dict"][key], other["state_dict"][key]) for key in one["state_dict"])


def counting(function, calls):
    def counted(*arguments):
        calls.append(1)
        return function(*arguments)

    return counted


def test_another_setting_is_another_training(monkeypatch, tmp_path, capfd):
    monkeypatch.setattr(payback, "compiled", interpreted)
    monkeypatch.setattr("ahnn.train.judge", lambda *_, **__: 0.0)
    options = [*FIRST, f"run={tmp_path / 'run'}", "trainer.max_epochs=1"]
    assert call("ahnn.train", *options, "compile=true") == 0
    assert call("ahnn.train", *options, "compile=false", "ckpt=last") == 2
    assert "compile: expected False, received True" in capfd.readouterr().err


REFUSED = {
    "compile=true": "optimizer: expected one that takes gradients with compile=true",
    "compile=true recipe=first_order integrator=gl4": "integrator: expected an explicit method with compile",
    "compile=maybe": "compile: expected auto or bool; received 'maybe'",
    "compile=true recipe=measurements data.noise=0.01 optimizer=adamw": "loss: expected recursive",
}


@pytest.mark.parametrize("options", REFUSED)
def test_what_cannot_be_compiled_is_refused(options, tmp_path, capfd):
    assert call("ahnn.train", *SMALL, *options.split(), f"run={tmp_path / 'run'}") == 2
    assert REFUSED[options] in capfd.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the compiler's own modules
@pytest.mark.slow
@pytest.mark.parametrize(("dtype", "rtol"), [(torch.float32, 1e-6), (torch.float64, 1e-12)])
def test_compiled_steps_are_those_of_autograd(dtype, rtol, tmp_path, monkeypatch):
    monkeypatch.delenv(compilation.PLACE, raising=False)
    dynamics = hamiltonian(dtype, "gelu", "midpoint")
    loss = Loss(4, LossOptions()).to(dtype)
    stepper = Compiled(6, partial(compiled, cache=tmp_path))
    assert_agree(stepper, Recursive(loss, 2), loss, dynamics, windows(dtype), rtol)
    assert not stepper.failed
    assert any((tmp_path / "compiled").rglob("*.so"))
    graph = traced(Compared(Recursive(loss, 2), loss, dynamics), windows(dtype))
    assert compilation.record(graph, tmp_path).exists()
