"""What a command imports: no garbage is looked for in it, then or later, and a mistake is told before it."""

from __future__ import annotations

import gc
import json
import os
import shutil
import signal
import subprocess
import sys

import pytest
from entry import SMALL, call, untouched

from ahnn.cli.importing import importing

ONCE = """
import gc
from ahnn.cli.importing import importing

with importing():
    assert not gc.isenabled()
    modules = [[]]
assert gc.isenabled()
assert not any(one is modules for one in gc.get_objects())
with importing():
    job = [[]]
assert any(one is job for one in gc.get_objects())
"""

STAGES = """
import json, sys
import torch.optim

stages = {}

def reached(stage):
    stages[stage] = sorted(sys.modules)

def fail(*_, **__):
    raise AssertionError("an optimiser was built")

import ahnn
reached("the package")
ahnn.load("molniya_mechanical")
reached("a model that is loaded")
built, torch.optim.Optimizer.__init__ = torch.optim.Optimizer.__init__, fail
from ahnn.evaluate import evaluate
evaluate(sys.argv[2:])
torch.optim.Optimizer.__init__ = built
reached("an evaluation")
from ahnn.cli.importing import import_torchmetrics
import_torchmetrics()
import torchmetrics
reached("torchmetrics")
assert float(torchmetrics.MeanMetric()(2.0)) == 2.0
import ahnn.jobs.closing, ahnn.jobs.fitting
reached("a training")
import ahnn_plugins.report.figures, ahnn_plugins.report.interactive
reached("the figures of a report")
import scipy.signal
assert scipy.signal.hilbert([1.0, 0.0, -1.0, 0.0]).imag.round(9).tolist() == [0.0, 1.0, 0.0, -1.0]
import_torchmetrics()
assert "hilbert" in dir(sys.modules["scipy.signal"])
open(sys.argv[1], "w").write(json.dumps(stages))
"""
"""What an interpreter imports one after the other, and that scipy.signal is whole for whoever wants it."""


TRAINER = {"lightning", "pytorch_lightning"}
HEAVY = {*TRAINER, "hydra", "omegaconf", "optuna", "matplotlib", "scipy"}
SPARED = {
    "the package": HEAVY,
    "a model that is loaded": HEAVY,
    "an evaluation": TRAINER,
    "torchmetrics": {"scipy.signal"},
    "a training": {"scipy.linalg", "scipy.optimize"},
    "the figures of a report": {"plotly"},
}


@pytest.fixture(scope="module")
def stages(finished, tmp_path_factory):
    """The modules that a new interpreter has after each stage."""
    place = tmp_path_factory.mktemp("stages")
    run, path = shutil.copytree(finished, place / "run"), place / "stages.json"
    options = [f"run={run}", "plugins=ukf", "plugins.ukf.cadence=10", "plugins.ukf.process_noise=[1e-6,1e-6]"]
    command = [sys.executable, "-c", STAGES, str(path), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(path.read_text())


@pytest.mark.parametrize("stage", SPARED)
def test_what_is_of_no_use_is_not_imported(stages, stage):
    """A stage adds none of these; the oldest libraries already import some of them for an earlier one."""
    order = [*SPARED]
    before = stages[order[order.index(stage) - 1]] if stage != order[0] else []
    assert not SPARED[stage] & ({*stages[stage]} - {*before})


def test_what_is_imported_first_is_left_alone_and_what_a_later_job_makes_is_not():
    done = subprocess.run([sys.executable, "-c", ONCE], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_garbage_is_collected_again_after_an_import_that_fails():
    with pytest.raises(ImportError), importing():
        raise ImportError
    assert gc.isenabled()


def test_a_collector_that_was_off_stays_off():
    gc.disable()
    try:
        with importing():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_a_signal_waits_until_all_is_imported():
    done = []

    def interrupted() -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)  # under nohup it is ignored
        with importing():
            os.kill(os.getpid(), signal.SIGINT)
            done.append("imported")

    with untouched(), pytest.raises(KeyboardInterrupt):
        interrupted()
    assert done == ["imported"]


@pytest.mark.parametrize(
    ("module", "mistake"),
    [
        ("ahnn.train", [*SMALL, "ckpt=last"]),
        ("ahnn.evaluate", ["run=nowhere"]),
        ("ahnn.predict", ["run=nowhere", "start=[0,0]", "duration=1"]),
        ("ahnn.export", ["run=nowhere"]),
        ("ahnn.report", ["nowhere"]),
        ("ahnn.assimilate", ["run=nowhere"]),
        ("ahnn.data.__main__", ["check", "nowhere.csv"]),
    ],
)
def test_every_command_imports_in_this_way(tmp_path, monkeypatch, module, mistake):
    monkeypatch.chdir(tmp_path)
    left = []
    monkeypatch.setattr("ahnn.cli.importing._leave_alone", lambda: left.append(module))
    assert call(module, *mistake) == 2
    assert left


@pytest.mark.parametrize("mode", [[], ["-m"]])
@pytest.mark.sampled(2)
def test_a_setting_that_is_wrong_is_told_before_torch_is_imported(tmp_path, mode):
    code = (
        f"import sys; sys.argv = ['ahnn-train', *{mode}, 'seed=x', 'hydra.sweep.dir={tmp_path}']\n"
        "from ahnn.train import main\n"
        "try: main()\n"
        "finally: assert not {'torch', 'lightning'} & {*sys.modules}"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2, done.stderr
    assert "ahnn: seed: expected int" in done.stderr
