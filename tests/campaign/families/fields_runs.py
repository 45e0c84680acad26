"""Fields of run folders: what stands beside weights, config.yaml, metrics.json, and the state of a stream.

A field of another kind is refused in a sentence, at every door alike; another legal value acts; a state that was
changed gives the same estimates or is refused; nothing that a folder names is written to or run.
"""

from __future__ import annotations

import copy
import json
import shutil
import tempfile
from functools import partial
from pathlib import Path

import torch
import yaml

import ahnn
from ahnn.checkpoints import Weights, read_weights, write_weights
from ahnn.cli.parts import build_source
from ahnn.cli.reevaluation import Request, run_config
from ahnn.evaluation import load_results

from .children import trained
from .doors import START, answered, assimilating, enter, fixes, numbers

SHIPPED = Path(ahnn.__file__).parent / "pretrained" / "molniya_mechanical"
NAN, INF, GONE = float("nan"), float("inf"), "(gone)"
ILLEGAL = {
    "dt": [NAN, INF, 0, -60.0, "x", None, [60.0], {}, GONE, True],
    "format": [3, 1, "x", None, GONE],
    "space": [None, [], "x", GONE, 7],
    "space.inertia": [0, -1.0, NAN, INF, "x", None, [], {}],
    "space.units": [[1, 2, 3, 4], ["s"], None, [], "skkk", ["s", "km", "km/s", 7], {}, GONE],
    "space.components": [[], ["x", "y", "z"], ["x"] * 6, [1, 2, 3, 4, 5, 6], None, 7, GONE],
    "space.frame": [7, [], {}],
    "space.name": [7, None, []],
    "dynamics": [None, [], "x", {}, GONE],
    "dynamics.kind": ["x", None, 7, "os.system"],
    "dynamics.dof": [0, 2, -1, 10**9, "x", None, 3.5, NAN],
    "dynamics.inertia": [0, -1.0, NAN, INF, "x", None, 2.0],
    "dynamics.hamiltonian": ["x", None, 7],
    "dynamics.inputs": ["x", None, 7],
    "dynamics.scaling": ["x", None, 7],
    "dynamics.network": [None, [], "x", {}],
    "dynamics.network.width": [33, 10**9, 0, -1, "x", None, NAN],
    "dynamics.network.depth": [10**6, -1, "x", None, 3],
    "dynamics.network.activation": ["x", None, 7],
    "dynamics.integrator": [None, [], "x", {}],
    "dynamics.integrator.name": ["x", None, 7],
    "domain": ["x", 7, [], {}],
    "domain.unit": [NAN, 0, -1.0, "x", None, GONE],
    "domain.states": [[], [[1.0]], "x", None, 7, [[NAN] * 6], GONE],
    "odd": ["x", 7],
}
"""Fields beside weights that every door uses, and values that none may take."""
UNUSED = {"val_loss": [NAN, "x", None, [], GONE], "data": ["x", None, 7, [], GONE], "data.recipe": ["x", None, 7, GONE],
          "data.split": ["x", None, [1], GONE, NAN], "odd": ["x"]}  # fmt: skip
"""Fields that evaluations alone use."""
ODD = [
    None,
    "x",
    "",
    [],
    {},
    [1],
    {"a": 1},
    -1,
    0,
    0.5,
    NAN,
    INF,
    1e308,
    True,
    10**12,
    "${oc.env:HOME}",
    GONE,
]
FILES = {
    "empty": b"",
    "a list": b"- 1\n- 2\n",
    "a text": b"run",
    "binary": bytes(range(256)),
    "nested": b"a: " + b"[" * 5000,
    "nested maps": b"".join(b" " * k + b"a:\n" for k in range(900)),
    "an alias": b"a: &a [1]\nb: *a\n",
    "an object": b"a: !!python/object/apply:os.system [true]\n",
    "two documents": b"a: 1\n---\nb: 2\n",
    "tabs": b"\ta: 1\n",
    "a null byte": b"a: \x00\n",
    "UTF-16": "a: 1\n".encode("utf-16"),
}


def cases(draw, folder):
    """Yield a file, one of its fields, a value and a door."""
    child = trained(folder / "run", "trainer.max_epochs=1")
    assert child.code() == 0, child.said()
    kinds = ["about"] * 4 + ["config"] * 3 + ["file", "metrics", "metrics"]
    while True:
        kind, place = draw.choice(kinds), Path(tempfile.mkdtemp(dir=folder))
        if kind == "about":
            table = draw.choice([ILLEGAL, ILLEGAL, ILLEGAL, UNUSED])
            name, door = (
                draw.choice(list(table)),
                draw.choice(["load", "load", "load", "predict", "assimilate"]),
            )
            value, suffix = draw.choice(table[name]), draw.choice([".safetensors", ".ckpt"])
            yield (
                f"{suffix} {name} {value}, {door}",
                partial(about, place, name, value, suffix, door, table is ILLEGAL),
            )
        elif kind == "config":
            config = yaml.safe_load((SHIPPED / "config.yaml").read_text())
            name, value, door = (
                draw.choice([*paths(config)]),
                draw.choice(ODD),
                draw.choice(["evaluate", "assimilate"]),
            )
            content = yaml.safe_dump(changed(config, name, value)).encode()
            yield f"config.yaml {name} {value}, {door}", partial(configured, place, content, door, False)
        elif kind == "file":
            name, door = draw.choice(list(FILES)), draw.choice(["evaluate", "assimilate"])
            yield f"config.yaml {name}, {door}", partial(configured, place, FILES[name], door, True)
        else:
            known = json.loads((folder / "run" / "metrics.json").read_text())
            name, value, door = (
                draw.choice([*paths(known)]),
                draw.choice(ODD),
                draw.choice(["results", "report"]),
            )
            yield (
                f"metrics.json {name} {value}, {door}",
                partial(measured, place, changed(known, name, value), door),
            )


def paths(content, before: str = ""):
    """Yield the names of all fields."""
    pairs = content.items() if isinstance(content, dict) else enumerate(content)
    for key, value in pairs:
        yield f"{before}{key}"
        if isinstance(value, dict | list) and len(value) < 20:
            yield from paths(value, f"{before}{key}.")


def changed(content: dict, name: str, value) -> dict:
    """Return a copy with another value of a field."""
    made = copy.deepcopy(content)
    node, (*above, key) = made, name.split(".")
    for each in above:
        node = node[int(each)] if isinstance(node, list) else node[each]
    key = int(key) if isinstance(node, list) else key
    if value == GONE:
        del node[key]
    else:
        node[key] = value
    return made


def copied(place: Path) -> Path:
    """Return a copy of the shipped model as a run folder of somebody's."""
    shutil.copytree(SHIPPED, place / "run", ignore=shutil.ignore_patterns("__pycache__"))
    return place / "run"


def beside(run: Path, content: dict, suffix: str = ".safetensors") -> None:
    """Put weights with that beside them into a run."""
    state = read_weights(SHIPPED / "weights.safetensors").state
    (run / "weights.safetensors").unlink()
    if suffix == ".safetensors":
        write_weights(run / "weights.safetensors", Weights(state, content))
    else:
        (run / "checkpoints").mkdir()
        whole = {"state_dict": {f"dynamics.{name}": part for name, part in state.items()}, "ahnn": content}
        torch.save(whole, run / "checkpoints" / "best.ckpt")


def about(place, name, value, suffix, door, used) -> None:
    """Change what stands beside weights."""
    run = copied(place)
    known = read_weights(SHIPPED / "weights.safetensors").about
    if name == "odd":
        known["dynamics"]["odd"] = value
    else:
        known = changed(known, name, value)
    beside(run, known, suffix)
    if door == "load":
        loaded = ahnn.load(run)
        loaded.predict([START], [0.0, 60.0])
        loaded.novelty([START])
    elif door == "predict":
        answered(
            *enter(
                place,
                "predict",
                f"run={run}",
                f"start={numbers(START)}",
                "duration=5min",
                f"output={place}/o.csv",
            )
        )
    else:
        words = assimilating(fixes(place / "fixes.csv"), f"output={place}/o.csv")[1:]
        answered(*enter(place, "assimilate", f"run={run}", *words))
    assert not used, "accepted"


def configured(place, content, door, damaged) -> None:
    """Change config.yaml; a whole file of something else is refused."""
    run = copied(place)
    (run / "config.yaml").unlink()
    (run / "config.yaml").write_bytes(content)
    if door == "evaluate":
        build_source(run_config(run, Request(run, run, "best", None, [], trust=False)))
    else:
        words = assimilating(fixes(place / "fixes.csv"), f"output={place}/o.csv")[1:]
        answered(*enter(place, "assimilate", f"run={run}", *words))
    assert not damaged, "accepted"


def measured(place, content, door) -> None:
    """Change metrics.json."""
    run = shutil.copytree(place.parent / "run", place / "run")
    (run / "metrics.json").unlink()
    (run / "metrics.json").write_text(json.dumps(content))
    if door == "results":
        load_results(run)
    else:
        answered(*enter(place, "report", f"run={run}", f"output={place}/report", "report.figures=false"))
