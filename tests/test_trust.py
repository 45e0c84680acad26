"""A run folder from elsewhere is data: nothing that it names is called, looked up or unpickled."""

from __future__ import annotations

import pickle
import shutil
from pathlib import Path

import pytest
import torch
import yaml
from entry import call

import ahnn
from ahnn.cli.trust import is_trusted
from ahnn.errors import UserError


@pytest.fixture
def run(finished, tmp_path):
    return Path(shutil.copytree(finished, tmp_path / "run"))


def touch(path):
    """A shell command that leaves a trace."""
    return f"touch {path}"


GADGETS = {
    "os.system": lambda trace: {"_target_": "os.system", "command": touch(trace)},
    "posix.system": lambda trace: {"_target_": "posix.system", "command": touch(trace)},
    "subprocess": lambda trace: {"_target_": "subprocess.check_output", "args": ["touch", str(trace)]},
    "popen": lambda trace: {"_target_": "subprocess.Popen", "args": ["touch", str(trace)]},
    "eval": lambda trace: {"_target_": "builtins.eval", "_args_": [f"open({str(trace)!r}, 'w')"]},
    "exec": lambda trace: {"_target_": "builtins.exec", "_args_": [f"open({str(trace)!r}, 'w')"]},
    "open": lambda trace: {"_target_": "builtins.open", "file": str(trace), "mode": "w"},
    "pathlib": lambda trace: {"_target_": "pathlib.Path.touch", "self": str(trace)},
    "runpy": lambda trace: {"_target_": "runpy.run_path", "path_name": str(trace)},
    "torch.load": lambda trace: {"_target_": "torch.load", "f": str(trace), "weights_only": False},
    "pickle": lambda trace: {"_target_": "pickle.load", "file": str(trace)},
    "numpy": lambda trace: {"_target_": "numpy.load", "file": str(trace), "allow_pickle": True},
    "shutil": lambda trace: {"_target_": "shutil.copyfile", "src": "/etc/hostname", "dst": str(trace)},
    "importlib": lambda _: {"_target_": "importlib.import_module", "name": "this"},
    "hydra": lambda trace: {
        "_target_": "hydra.utils.instantiate",
        "config": {"_target_": "os.system", "command": touch(trace)},
    },
    "our files": lambda trace: {
        "_target_": "ahnn.files.write_atomically",
        "path": str(trace),
        "content": "x",
    },
    "our lock": lambda trace: {"_target_": "ahnn.files.claimed", "folder": str(trace)},
    "our entry": lambda _: {"_target_": "ahnn.train.main"},
    "our module's import": lambda trace: {
        "_target_": "ahnn.cli.trust.inspect.os.system",
        "command": str(trace),
    },
    "our plugin's import": lambda _: {"_target_": "ahnn_plugins.ukf.tuning.hashlib.sha256"},
    "a source of other data": lambda _: {"_target_": "ahnn.loading.load", "run": "/"},
    "a partial": lambda trace: {"_target_": "functools.partial", "_args_": ["os.system", touch(trace)]},
    "no text": lambda _: {"_target_": ["os.system"]},
}
DOORS = {
    "system": lambda node: {"system": node},
    "plugin": lambda node: {"plugins": {"ukf": node}},
    "measurement": lambda node: {"measurement": {"model": node, "sd": 1.0}},
    "nested in a plugin": lambda node: {
        "plugins": {"ukf": {"_target_": "ahnn_plugins.ukf.plugin.UKFEvaluation", "measurement": node}}
    },
    "beside a model": lambda node: {
        "plugins": {"ukf": {"_target_": "ahnn_plugins.ukf.plugin.UKFEvaluation", "beside": node}}
    },
    "in a list": lambda node: {
        "plugins": {"ukf": {"_target_": "ahnn_plugins.ukf.plugin.UKFEvaluation", "x": [node]}}
    },
}


def change(run: Path, **entries) -> None:
    path = run / "config.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | entries))


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("gadget", GADGETS)
@pytest.mark.sampled(2)
def test_no_gadget_passes_any_door(run, tmp_path, capfd, gadget, door):
    trace = tmp_path / "trace"
    change(run, **DOORS[door](GADGETS[gadget](trace)))
    assert call("ahnn.evaluate", f"run={run}") == 2
    err = capfd.readouterr().err
    assert "add --trust" in err
    assert "Traceback" not in err
    assert not trace.exists()
    assert not (run / "evaluations").exists()


@pytest.mark.parametrize(
    "value",
    ["${oc.env:SECRET}", "${measurement.${oc.env:SECRET}}", "${oc.decode:'${oc.env:SECRET}'}", "${now:%Y}"],
)
def test_nothing_is_looked_up_outside_of_the_configuration(run, capfd, monkeypatch, value):
    monkeypatch.setenv("SECRET", "hunter2")
    for node in ("system", "evaluation", "plugins", "measurement"):
        change(run, **{node: {"x": value}})
        assert call("ahnn.evaluate", f"run={run}") == 2
        out, err = capfd.readouterr()
        assert "hunter2" not in out + err
    assert not (run / "evaluations").exists()


def test_what_a_user_trusts_is_built(run, capfd):
    change(run, plugins={"x": {"_target_": "builtins.dict"}})
    assert call("ahnn.evaluate", f"run={run}") == 2
    assert call("ahnn.evaluate", f"run={run}", "--trust") == 2
    assert "add --trust" not in capfd.readouterr().err.splitlines()[-1]


def test_our_own_targets_are_trusted():
    assert is_trusted("ahnn.systems.MassSpring", "system")
    assert is_trusted("ahnn_plugins.ukf.plugin.UKFEvaluation", "plugins")
    assert is_trusted("ahnn.measurements.GroundStation", "measurement")
    assert not is_trusted("ahnn.systems.MassSpring", "plugins")
    assert not is_trusted("ahnn.systems.MassSpring", "label")


class Gadget:
    """Leaves a trace when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (str(self.path), "w")


@pytest.mark.parametrize(
    "file", ["checkpoints/best.ckpt", "weights.safetensors", "metrics.json", "config.yaml"]
)
@pytest.mark.parametrize("how", ["torch", "pickle"])
def test_no_file_of_a_run_is_unpickled(run, tmp_path, file, how):
    trace, path = tmp_path / "trace", run / file
    shutil.rmtree(run / "checkpoints") if file == "weights.safetensors" else None
    if how == "torch":
        torch.save({"state_dict": {}, "ahnn": Gadget(trace), "x": Gadget(trace)}, path)
    else:
        path.write_bytes(pickle.dumps(Gadget(trace)))
    assert call("ahnn.evaluate", f"run={run}") == 2
    if file.startswith(("checkpoints", "weights")):
        with pytest.raises(UserError):
            ahnn.load(run)
        assert call("ahnn.predict", f"run={run}", "start=[0.1,0]", "duration=1") == 2
        assert call("ahnn.export", f"run={run}", f"output={tmp_path / 'out'}") == 2
    assert not trace.exists()


def test_a_link_among_the_figures_is_refused_and_not_followed(run, tmp_path):
    dear = tmp_path / "dear"
    dear.write_text("keep")
    target = run / "evaluations" / "mine" / "figures"
    target.mkdir(parents=True)
    (target / "error.png").symlink_to(dear)
    assert call("ahnn.evaluate", f"run={run}", "name=mine", "evaluation.figures=true") == 2
    assert dear.read_text() == "keep"
    assert (target / "error.png").is_symlink()


def test_a_label_that_looks_things_up_is_a_text(run, capfd, monkeypatch):
    monkeypatch.setenv("SECRET", "hunter2")
    change(run, label="${oc.env:SECRET}")
    assert call("ahnn.evaluate", f"run={run}") == 2
    out, err = capfd.readouterr()
    assert "hunter2" not in out + err


def test_what_measures_is_built_from_a_run_of_ones_own():
    assert is_trusted("ahnn.measurements.Several", "data")
    assert is_trusted("ahnn.measurements.GroundStation", "data")
    assert not is_trusted("ahnn.data.sensor.Sensor", "data")
