"""Run folders from elsewhere: damaged or hostile YAML, which must call and look up nothing."""

from __future__ import annotations

import os
from functools import partial

import yaml

from ahnn.cli.guard import in_words
from ahnn.cli.reevaluation import KEYS, NODES, Request, run_config

from .damage import damaged

TARGETS = [
    "os.system",
    "subprocess.Popen",
    "builtins.exec",
    "builtins.eval",
    "builtins.open",
    "pathlib.Path.touch",
    "runpy.run_path",
    "torch.load",
    "numpy.load",
    "pickle.load",
    "shutil.rmtree",
    "importlib.import_module",
    "ahnn.files.write_atomically",
    "ahnn.train.main",
    "hydra.utils.instantiate",
    "functools.partial",
    "os.remove",
    "ctypes.CDLL",
]
LOOKUPS = [
    "${oc.env:AHNN_SECRET}",
    "${oc.decode:${oc.env:AHNN_SECRET}}",
    "${measurement.${oc.env:AHNN_SECRET}}",
]
GOOD = {
    "system": {"_target_": "ahnn.systems.MassSpring", "name": "s", "dt": 0.1, "steps": 9},
    "data": {"trajectories": 20, "split": [0.8, 0.1, 0.1], "seed": 0, "cache": "/tmp/none"},
    "evaluation": {"seed": 0, "save_predictions": False, "figures": False},
    "plugins": {
        "ukf": {"_target_": "ahnn_plugins.ukf.plugin.UKFEvaluation", "measurement": "${measurement.model}"}
    },
    "measurement": {"model": "position", "sd": None},
    "label": "mine",
    "threads": 1,
}


def cases(draw, folder):
    """Yield hostile configurations."""
    os.environ["AHNN_SECRET"] = "hunter2"
    good = yaml.safe_dump(GOOD).encode()
    while True:
        if draw.random() < 0.4:
            what, content = damaged(draw, good)
        else:
            what, content = hostile(draw)
        yield what, partial(attempt, folder, content)


def hostile(draw) -> tuple[str, bytes]:
    """Return a configuration that would call or look up something."""
    node = draw.choice([*NODES, *KEYS])
    target = draw.choice(TARGETS)
    thing = {"_target_": target, "_args_": ["touch /tmp/ahnn_campaign_trace"]}
    value = draw.choice(
        [thing, {"x": thing}, [thing], {"x": [{"y": thing}]}, draw.choice(LOOKUPS), {"x": LOOKUPS[0]}]
    )
    return f"{node}: {value}", yaml.safe_dump(GOOD | {node: value}).encode()


def attempt(folder, content) -> None:
    """Read the configuration as an evaluation does; what is accepted must be plain and ours."""
    (folder / "config.yaml").write_bytes(content)
    with in_words():  # as every door calls it
        cfg = run_config(folder, Request(folder, folder, "best", None, [], trust=False))
    text = str(cfg)
    assert not any(f"'{target}'" in text for target in TARGETS), "a foreign target"
    assert "hunter2" not in text, "a secret"
