"""Exported models give what eager ones give, whole or not at all, and run where there is no ahnn."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from entry import call, untouched
from helpers import close, data_module, random_states, ready_model
from safetensors.torch import load_file
from scipy.special import ndtr

import ahnn
from ahnn.checkpoints import Weights, checksum
from ahnn.dynamics import HasEnergy
from ahnn.errors import UserError
from ahnn.graphs import write_export
from ahnn.graphs.modules import modules, normal
from ahnn.graphs.programs import as_onnx, program
from ahnn.loading import made
from ahnn.pretrained import names
from ahnn.stored import about_space
from ahnn.systems import Kepler

ort = pytest.importorskip("onnxruntime")
pytest.importorskip("onnxscript", reason="the extra `export` is needed")
KEPLER = Kepler(name="kepler", dt=0.05, steps=40)
EXAMPLE = Path(__file__).parents[2] / "examples" / "run_exported.py"


def session(model, level="ORT_ENABLE_BASIC"):
    """Beyond the basic ones, optimisations of the runtime round some factors to single precision."""
    options = ort.SessionOptions()
    options.graph_optimization_level = getattr(ort.GraphOptimizationLevel, level)
    return ort.InferenceSession(model, options, providers=["CPUExecutionProvider"])


def require_parity(module, x, rtol=1e-12):
    """Program and ONNX against the eager module, on batches of sizes that were not traced."""
    found = program(module, x.shape[1])
    graph = as_onnx(found)
    runtime, fused = session(graph), session(graph, "ORT_ENABLE_ALL")
    for part in (x, x[:1], x[:3]):
        eager = module(part)
        close(found.module()(part), eager, rtol)
        for each, least in ((runtime, rtol), (fused, 1e-8)):
            close(torch.from_numpy(each.run(None, {"states": part.numpy()})[0]), eager, least)


def orbits(count):
    """States of Molniya orbits and of others, which no training has seen."""
    draw = torch.randn(count, 6, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return draw * torch.tensor([2e4] * 3 + [4.0] * 3, dtype=torch.float64)


def learned(cache, kind="hnn", **changes):
    """A tiny untrained model of a kind, calibrated, as a run."""
    data = data_module(KEPLER, cache, steps=40)
    model = ready_model(kind, data, **changes)
    about = {**model.about, "dynamics": model.dynamics.spec, "val_loss": 1.0}
    return made(Weights(model.dynamics.state_dict(), about), Path("tiny"))


@pytest.mark.slow
@pytest.mark.parametrize("name", names())
def test_a_shipped_model_is_exported_exactly(name):
    run = ahnn.load(name)
    for module in modules(run.dynamics, run.dt).values():
        require_parity(module, orbits(100))


KINDS = {
    "mlp": {"network": {"width": 6, "depth": 2, "activation": "gelu"}},
    "mlp_residual": {"network": {"width": 6, "depth": 1, "activation": "silu"}},
    "node": {"integrator": {"name": "dopri5"}},
    "generic": {"network": {"width": 6, "depth": 2, "activation": "sine"}, "integrator": {"name": "dopri8"}},
    "separable": {"integrator": {"name": "yoshida4"}, "scaling": "minmax"},
    "mechanical": {"integrator": {"name": "kahan_li8"}, "inputs": "isotropic"},
    "central_body": {"integrator": {"name": "midpoint"}},
}


@pytest.mark.parametrize(
    "kind", [k if k == "mlp" else pytest.param(k, marks=pytest.mark.slow) for k in KINDS]
)
def test_every_kind_of_model_is_exported_exactly(kind, cache):
    run = learned(cache, kind, **KINDS[kind])
    parts = modules(run.dynamics, run.dt)
    assert ("energy" in parts) is isinstance(run.dynamics, HasEnergy)
    x = random_states(KEPLER, 20, 1)
    close(parts["flow"](x), run.flow(x), 1e-14)
    for module in parts.values():
        require_parity(module, x)


def test_the_normal_distribution_without_the_error_function():
    z = torch.linspace(-45, 45, 100_001, dtype=torch.float64)
    oracle = torch.from_numpy(ndtr(z.numpy()))
    assert float((normal(z) - oracle).abs().max()) < 1e-15
    tail = (z < 0) & (z > -5)
    assert float((normal(z) / oracle - 1)[tail].abs().max()) < 1e-12


@pytest.mark.slow
def test_a_folder_has_all_that_runs_the_model_elsewhere(tmp_path, capsys):
    folder, name = tmp_path / "there" / "mine", names()[0]
    assert call("ahnn.export", f"pretrained={name}", f"output={folder}") == 0
    listed = {"energy.onnx", "energy.pt2", "flow.onnx", "flow.pt2", "model.json", "weights.safetensors"}
    assert {path.name for path in folder.iterdir()} == listed
    said = capsys.readouterr().out
    assert all(word in said for word in listed)
    run, about = ahnn.load(name), json.loads((folder / "model.json").read_text())
    units = {"time": "s", "position": "km", "velocity": "km/s", "energy": "km²/s²"}
    assert about["space"] == about_space(run.space) | {"units": units}
    assert about["format"] == 2
    assert about["dt"] == run.dt
    assert about["provenance"]["ahnn"] == ahnn.__version__
    state = load_file(folder / "weights.safetensors")
    assert (
        about["provenance"]["sha256_of_weights"]
        == checksum(state, "")
        == checksum(run.dynamics.state_dict(), "")
    )
    for key, value in about["scalings"].items():
        close(torch.tensor(value, dtype=torch.float64), state[key].double(), 1e-15)
    energy = torch.export.load(folder / "energy.pt2").module()
    close(energy(orbits(9)), run.energy(orbits(9)), 1e-14)
    environment = os.environ | {"PYTHONPATH": ""}
    code = f"import sys; sys.modules['ahnn'] = sys.modules['torch'] = None; sys.argv[1] = {str(folder)!r}; "
    done = subprocess.run(
        [sys.executable, "-c", code + f"exec(open({str(EXAMPLE)!r}).read())", "folder"],
        env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    start = [0.0, -3145.0, -6173.0, 10.0, 0.0, 0.0]
    end = run.rollout(start, steps=60)[0, -1]
    numbers = [float(number) for number in re.findall(r"': ([^,}]+)", done.stdout)]
    np.testing.assert_allclose(numbers, end.numpy(), rtol=1e-10)


def test_an_implicit_integrator_is_refused_before_anything_is_written(tmp_path, cache):
    run = learned(cache, "generic", integrator={"name": "gl4"})
    with pytest.raises(UserError, match=r"integrator gl4: expected an explicit one.*rk4 or a composition"):
        write_export(run, tmp_path / "mine")
    assert not list(tmp_path.iterdir())


def test_what_fails_in_the_middle_leaves_nothing(tmp_path, cache, monkeypatch):
    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("ahnn.graphs.folder.packed", fail)
    monkeypatch.setattr("ahnn.graphs.folder.as_onnx", lambda _: b"")
    with pytest.raises(OSError, match="No space"):
        write_export(learned(cache, "mlp"), tmp_path / "mine")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "usage: python -m ahnn.export"),
        (["output=x"], "expected run=DIR or pretrained=NAME; received neither"),
        (["run=.", "pretrained=molniya_mechanical", "output=x"], "received both"),
        (["pretrained=molniya_mechanical"], "expected key 'output'; received pretrained. Add output=VALUE"),
        (["pretrained=molniya_mechanical", "ouput=x"], "did you mean 'output'?"),
        (["pretrained=molniya_mechanical", "output=."], "output: expected a new folder"),
        (["run=[a,b]", "output=x"], "run: expected str or None"),
        (["run=nowhere", "output=x"], "expected a run folder"),
    ],
)
def test_mistakes_are_one_message(arguments, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert call("ahnn.export", *arguments) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_missing_package_is_named_with_the_extra(tmp_path, cache, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    with pytest.raises(UserError, match=r"ahnn\[export\]"):
        write_export(learned(cache, "mlp"), tmp_path / "mine")
    assert not list(tmp_path.iterdir())


def test_help_says_what_there_is(capsys):
    with untouched():
        assert call("ahnn.export", "--help") == 0
    assert "output=FOLDER" in capsys.readouterr().out
