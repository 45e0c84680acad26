"""Exported models whose forces depend on time or controls: a step takes states and a clock."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from helpers import close, generator

import ahnn
from ahnn.dynamics import make_dynamics
from ahnn.graphs import write_export
from ahnn.graphs.modules import modules
from ahnn.graphs.programs import as_onnx, program
from ahnn.types import Space, Units

ort = pytest.importorskip("onnxruntime")
pytest.importorskip("onnxscript", reason="the extra `export` is needed")
DOUBLE = {"dtype": torch.float64}
CONTROLS = ("u", "w")


@pytest.fixture(scope="module")
def run():
    torch.manual_seed(0)
    forces = {"controls": {"kind": "actuation"}, "network": {"sees": ["q", "v", "t"]}, "friction": {}}
    dynamics = make_dynamics(
        "hamiltonian",
        dof=1,
        inertia=1.5,
        hamiltonian="mechanical",
        mu=None,
        inputs="cartesian",
        scaling="none",
        network={"width": 6, "depth": 2, "activation": "tanh"},
        integrator={"name": "rk4"},
        forces=forces,
        controls=2,
    ).double()
    for parameter in dynamics.parameters():
        parameter.data += 0.3 * torch.randn(parameter.shape, generator=generator(4), **DOUBLE)
    space = Space("made", ("q", "p"), Units("s", "m", "m/s", "J"), inertia=1.5, controls=CONTROLS)
    return ahnn.Run(dynamics.frozen(), space, 0.2, {}, Path("tiny"))


def test_the_exported_step_is_that_of_a_rollout_under_the_same_controls(run):
    x, u = torch.randn(5, 2, generator=generator(0), **DOUBLE), torch.randn(5, 1, 2, **DOUBLE)
    clock = torch.cat((torch.full((5, 1), 0.7, **DOUBLE), u[:, 0]), dim=-1)
    expected = run.rollout(x, 1, start_time=0.7, controls=u)[:, 1]
    found = program(modules(run.dynamics, run.dt)["flow"], 2, 3)
    close(found.module()(x, clock), expected, 1e-13)
    graph = ort.InferenceSession(as_onnx(found), providers=["CPUExecutionProvider"])
    for part in (slice(0, 5), slice(0, 1)):
        given = {"states": x[part].numpy(), "clock": clock[part].numpy()}
        close(torch.from_numpy(graph.run(None, given)[0]), expected[part], 1e-9)
    later = torch.cat((clock[:, :1] + 1.0, clock[:, 1:]), dim=-1)
    assert float((found.module()(x, later) - expected).abs().max()) > 1e-4


@pytest.mark.slow
def test_the_folder_says_what_the_clock_is(run, tmp_path):
    assert "flow.onnx" in write_export(run, tmp_path / "out")
    about = json.loads((tmp_path / "out" / "model.json").read_text())
    assert about["graphs"]["flow"]["clock"]["components"] == ["time", "u", "w"]
