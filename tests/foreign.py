"""A small run as somebody else would have it, every command on it, and what one message is."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import yaml
from entry import FIRST, call

from ahnn.checkpoints import read_weights, write_weights
from ahnn.loading import weights_path

ONE = [*FIRST, "trainer.max_epochs=1"]


def trained(folder: Path) -> Path:
    """A run whose configuration names a cache of its own, its weights as safetensors."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AHNN_CACHE", str(folder.parent / "theirs"))
        assert call("ahnn.train", *ONE, f"run={folder}") == 0
    weights = read_weights(weights_path(folder))
    shutil.rmtree(folder / "checkpoints")
    write_weights(folder / "weights.safetensors", weights)
    return folder


def doors(run, tmp_path):
    """Every command on a run, with arguments that are right."""
    lines = tmp_path / "lines.csv"
    lines.write_text("time,q,p\n0.01,0.5,0.0\n")
    start = ["start=[0.5,0]"]
    return {
        "predict": ("ahnn.predict", f"run={run}", *start, "duration=1"),
        "evaluate": ("ahnn.evaluate", f"run={run}"),
        "export": ("ahnn.export", f"run={run}", f"output={tmp_path / 'exported'}"),
        "assimilate": (
            *("ahnn.assimilate", f"run={run}", f"measurements={lines}", *start, "start_sd=[1,1]"),
            *(
                "measurement=state",
                "measurement.sd=0.1",
                "plugins.ukf.process_noise=[1,1]",
                f"output={tmp_path / 'out.csv'}",
            ),
        ),
    }


def refused(command, capfd, said=""):
    """Assert that a command ends with one message."""
    assert call(*command) == 2
    err = capfd.readouterr().err
    assert err.startswith("ahnn: ")
    assert err.count("\n") == 1
    assert len(err) < 2000
    assert said in err


def change(values, path, new):
    """Nested plain values with another one under a dotted path; ... takes it out."""
    key, _, rest = path.partition(".")
    values = dict(values)
    if rest:
        values[key] = change(values[key], rest, new)
    elif new is ...:
        del values[key]
    else:
        values[key] = new
    return values


def configured(run, path, value):
    file = run / "config.yaml"
    file.write_text(yaml.safe_dump(change(yaml.safe_load(file.read_text()), path, value)))
