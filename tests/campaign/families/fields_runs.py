"""Fields of run folders: what stands beside weights, config.yaml, metrics.json, and the state of a stream.

A field of another kind is refused in a sentence, at every door alike; another legal value acts; a state that was
changed gives the same estimates or is refused; nothing that a folder names is written to or run.
"""

from __future__ import annotations

import copy
import json
import os
import shutil
import sys
import tempfile
from functools import partial
from pathlib import Path

import torch
import yaml
from safetensors import safe_open
from safetensors.torch import save

import ahnn
from ahnn.checkpoints import Weights, read_weights, write_weights
from ahnn.cli.again import Request, run_config
from ahnn.cli.parts import build_source
from ahnn.errors import UserError
from ahnn.evaluation import load_results

from .children import Child, command, plain, trained
from .doors import FIXES, NOISE, START, answered, assimilating, enter, fixes, numbers

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
ODD = [None, "x", "", [], {}, [1], {"a": 1}, -1, 0, 0.5, NAN, INF, 1e308, True, 10**12, "${oc.env:HOME}", GONE]
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
STATE = ["lines", "place", "digest", "size", "header", "counts", "clock"]


def cases(draw, folder):
    """Yield a file, one of its fields, a value and a door."""
    child = trained(folder / "run", "trainer.max_epochs=1")
    assert child.code() == 0, child.said()
    kinds = ["about"] * 4 + ["config"] * 3 + ["file", "metrics", "metrics", "state", "state", "state", "legal", "planted"]
    while True:
        kind, place = draw.choice(kinds), Path(tempfile.mkdtemp(dir=folder))
        if kind == "about":
            table = draw.choice([ILLEGAL, ILLEGAL, ILLEGAL, UNUSED])
            name, door = draw.choice(list(table)), draw.choice(["load", "load", "load", "predict", "assimilate"])
            value, suffix = draw.choice(table[name]), draw.choice([".safetensors", ".ckpt"])
            yield f"{suffix} {name} {value}, {door}", partial(about, place, name, value, suffix, door, table is ILLEGAL)
        elif kind == "config":
            config = yaml.safe_load((SHIPPED / "config.yaml").read_text())
            name, value, door = draw.choice([*paths(config)]), draw.choice(ODD), draw.choice(["evaluate", "assimilate"])
            content = yaml.safe_dump(changed(config, name, value)).encode()
            yield f"config.yaml {name} {value}, {door}", partial(configured, place, content, door, False)
        elif kind == "file":
            name, door = draw.choice(list(FILES)), draw.choice(["evaluate", "assimilate"])
            yield f"config.yaml {name}, {door}", partial(configured, place, FILES[name], door, True)
        elif kind == "metrics":
            known = json.loads((folder / "run" / "metrics.json").read_text())
            name, value, door = draw.choice([*paths(known)]), draw.choice(ODD), draw.choice(["results", "report"])
            yield f"metrics.json {name} {value}, {door}", partial(measured, place, changed(known, name, value), door)
        elif kind == "state":
            name, value = draw.choice([*STATES, *STATE]), draw.choice(ODD)
            yield f"state {name} {value}", partial(saved, place, name, value)
        elif kind == "legal":
            name = draw.choice(list(LEGAL))
            yield f"another {name}", partial(LEGAL[name], place)
        else:
            name, door = draw.choice(PLANTED), draw.choice(["evaluate", "report", "predict", "assimilate", "train"])
            yield f"{name} in the folder, {door}", partial(planted, place, name, door)


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
        answered(*enter(place, "predict", f"run={run}", f"start={numbers(START)}", "duration=5min", f"output={place}/o.csv"))
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


def negated(tensor):
    """Return a tensor with another sign."""
    return -tensor


STATES = {
    "mean, negated": ("mean", negated), "mean, NaN": ("mean", lambda t: t * NAN), "mean, single": ("mean", torch.Tensor.float),
    "chol, doubled": ("chol", lambda t: 2 * t), "chol, empty": ("chol", lambda t: t[:0]), "time, NaN": ("time", lambda t: t * NAN),
    "time, later": ("time", lambda t: t + 60), "steps": ("steps", lambda t: t + 1), "status": ("status", lambda t: t + 1),
    "rejections": ("rejections", lambda t: t + 3), "mean, moved": ("mean", lambda t: t + 1.0),
    "readings": ("readings", lambda _: "[]"), "since": ("since", lambda _: "nan"), "since, earlier": ("since", lambda _: "0.0"),
    "of": ("of", lambda _: "0"), "readings, moved": ("readings", lambda text: text.replace("[[120.0", "[[121.0")),
}  # fmt: skip
"""Changes of the tensors and notes of a saved stream."""


def saved(place, name, value) -> None:
    """Go on from a changed state; what comes out is what would have come out, or nothing."""
    measurements, state = place / "fixes.csv", place / "s"
    words = assimilating(measurements, "window=120", f"state={state}", f"output={place}/o.csv")
    more = [(t + 180, *rest) for t, *rest in FIXES]
    fixes(measurements)
    code, said = enter(place, "assimilate", *words)
    assert code == 0, said[-300:]
    fixes(measurements, [*FIXES, *more])
    shutil.copy(place / "o.csv", place / "kept.csv")
    shutil.copy(state, place / "kept")
    code, said = enter(place, "assimilate", *words)
    assert code == 0, said[-300:]
    expected = (place / "o.csv").read_text()
    shutil.copy(place / "kept.csv", place / "o.csv")
    with safe_open(place / "kept", framework="pt") as file:
        parts, notes = {key: file.get_tensor(key) for key in file.keys()}, file.metadata()  # noqa: SIM118
    if name in STATES:
        key, act = STATES[name]
        table = parts if key in parts else notes
        table[key] = act(table[key])
    else:
        notes["stream"] = json.dumps(changed(json.loads(notes["stream"]), name, value))
    state.write_bytes(save({key: part.contiguous() for key, part in parts.items()}, notes))
    code, said = enter(place, "assimilate", *words)
    answered(code, said)
    assert (place / "o.csv").read_text() == expected, f"other estimates, exit code 0: {said[-200:]}"


def predicted(place: Path, change, *more: str) -> list[list[str]]:
    """Return the cells of a prediction with something else beside the weights."""
    run, known = copied(place), read_weights(SHIPPED / "weights.safetensors").about
    change(known)
    beside(run, known)
    words = [f"run={run}", f"start={numbers(START)}", "duration=10min", f"output={place}/o.csv", *more]
    answered(*enter(place, "predict", *words))
    return [line.split(",") for line in (place / "o.csv").read_text().splitlines()]


def another_step(place: Path) -> None:
    """The step between predictions is that of the training."""
    rows = predicted(place, lambda known: known.update(dt=30.0))
    assert float(rows[2][1]) == 30.0, rows[2][:2]


def another_mass(place: Path) -> None:
    """Velocities are momenta over the mass."""

    def change(known: dict) -> None:
        known["space"]["inertia"] = known["dynamics"]["inertia"] = 2.0

    rows = predicted(place, change)
    column = rows[0].index("vx [km/s]")
    assert float(rows[1][column]) == 5.0, rows[1]


def another_name(place: Path) -> None:
    """Columns have the names and units of the space."""

    def change(known: dict) -> None:
        known["space"]["components"] = ["a", "b", "c", "pa", "pb", "pc"]
        known["space"]["units"] = ["min", "m", "m/min", "J"]

    assert predicted(place, change, "duration=10min")[0][1:4] == ["t [min]", "a [m]", "b [m]"]


def another_cache(place: Path) -> None:
    """A folder says not where is written."""
    run = shutil.copytree(place.parent / "run", place / "run")
    config = yaml.safe_load((run / "config.yaml").read_text())
    config["data"] |= {"cache": str(place / "elsewhere"), "seed": 5}
    (run / "config.yaml").unlink()
    (run / "config.yaml").write_text(yaml.safe_dump(config))
    code, said = enter(place, "evaluate", f"run={run}", "name=x", "plugins=none")
    assert not (place / "elsewhere").exists(), "written where a foreign folder said"
    answered(code, said)


LEGAL = {"step": another_step, "mass": another_mass, "name": another_name, "cache": another_cache}
PLANTED = ["hydra_plugins/x.py", "hydra_plugins/__init__.py", "ahnn_plugins/__init__.py", "sitecustomize.py",
           "ahnn_plugins/x.py", "ahnn/__init__.py", "numpy.py", "yaml.py"]  # fmt: skip


def planted(place, name, door) -> None:
    """Work in a folder that has code of the names of ours; none of it is run."""
    run = shutil.copytree(place.parent / "run", place / "run")
    (run / name).parent.mkdir(exist_ok=True)
    (run / name).write_text(f"open({str(place / 'executed')!r}, 'w').close()\n")
    words = {
        "evaluate": ["run=.", "name=x", "plugins=none"],
        "report": ["run=.", "report.figures=false"],
        "predict": ["run=.", "start=[0.1,0]", "duration=1s"],
        "assimilate": ["run=.", f"measurements={fixes(place / 'f.csv', [(0.1, 0.1)], 'time,q')}", "start=[0.1,0.0]",
                       "start_sd=[1,1]", "measurement.sd=0.1", NOISE, f"output={place}/o.csv"],
        "train": ["run=.", "trainer.max_epochs=1", "ckpt=last"],
    }  # fmt: skip

    def work() -> None:
        os.chdir(run)
        sys.path.insert(0, "")  # as python -m does
        command(f"ahnn.{door}", *words[door])()

    child = Child(work, place / "log")
    code, said = child.code(60), child.said()
    assert not (place / "executed").exists(), f"executed {name}"
    plain(said)
    if code:
        raise UserError(said)
