"""Controls in Python, beside trajectories, beside weights and in evaluations: the same ones give the same numbers.

Predictions and rollouts are held against the motion in closed form, what a training reads against the numbers of its
file, a run whose fields are of another kind against a refusal.
"""

from __future__ import annotations

import copy
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
import torch

import ahnn
from ahnn.data import Files, Given
from ahnn.dynamics.flow_at_time import at, steered
from ahnn.types import Trajectories

from .children import trained
from .doors import answered, enter, taken
from .fields_runs import NAN, ODD, changed
from .pushed_body import FREE, MASS, SPACE, STEP, Table, spec, written
from .readings import heard
from .tensors_files import LAYOUTS

NUMBERS = {
    "nothing": lambda a: a, "a NaN": lambda a: put(a, NAN), "infinite": lambda a: put(a, np.inf), "huge": lambda a: put(a, 1e151),
    "large": lambda a: 1e100 * a, "one row less": lambda a: a[:-1], "one row more": lambda a: np.concatenate((a, a[:1])),
    "one column": lambda a: a[:, :1], "three columns": lambda a: np.concatenate((a, a[:, :1]), 1), "transposed": lambda a: a.T,
    "flat": lambda a: a.ravel(), "one number": lambda _: 1.0, "none": lambda _: None, "empty": lambda a: a[:0],
    "of each start": lambda a: np.stack((a, a)), "of three starts": lambda a: np.stack((a,) * 3), "of one start": lambda a: a[None],
    "text": lambda _: "u", "texts": lambda a: a.astype(str), "complex": lambda a: a + 0j, "booleans": lambda a: a > 0,
    "dates": lambda a: a.astype("datetime64[s]"), "ragged": lambda _: [[1.0, 2.0], [3.0]], "a dict": lambda a: {"u": a},
    "objects of None": lambda a: put(a.astype(object), None), "masked": lambda a: np.ma.masked_less(a, -1.0), "a set": lambda _: {1.0},
    "a path": lambda _: Path("c.csv"), "meta": lambda a: torch.empty(a.shape, device="meta"), "sparse": lambda a: torch.tensor(a).to_sparse(),
}  # fmt: skip
"""Changes of the controls (T, 2); those of `GOOD` are numbers that may pass."""
GOOD = {"nothing", "large", "of each start"}
FIELDS = {
    "space.controls": [[], ["u"], ["u", "u"], ["u", "w", "x"], [1, 2], "uw", None, 7, ["u", ""], {}, ["q", "u"]],
    "dynamics.controls": [0, 1, 3, -1, 10**9, 2.5, "x", None, NAN, True],
    "dynamics.forces": [None, [], "x", {}, {"push": {}}, {"push": None}, {"push": {"kind": "x"}}, {"push": {"kind": "friction"}}, 7],
    "dynamics.forces.push.kind": ["x", None, 7, "os.system", "forcing"],
    "dynamics.forces.push.matrix": [[[1.0]], [[1.0, 2.0, 3.0]], [], [[1.0, 2.0]] * 2, "x", 7, [[NAN, 1.0]], [["x", 1.0]], None, [[1e300, 1e300]]],
    "dynamics.forces.push.odd": [1, None], "dynamics.forces.push.of": ["x", "positions", 7],
}  # fmt: skip
"""Fields beside weights, and values that none may take."""
CELLS = ["abc", "inf", "1e999", "1e151", "1_000", "", "nan", "0x1", "true"]
AGAIN = ["system.push=0", "system.push=3", "system.push=-1", "system.push=1e200", "system.push=.nan", "system.held=0", "system.held=1",
         "system.held=1000", "system.held=2.5", "system.controls=[]", "system.signal=1", "model.forces=1", "data.seed=3"]  # fmt: skip
SMALL = ["system=cart_pole", "hamiltonian=mass_matrix", "inputs=angles", "forces=controls", "loss=recursive", "trainer.max_epochs=1"]  # fmt: skip


def put(array: np.ndarray, value: object) -> np.ndarray:
    """Return a copy with another number in its middle."""
    made = np.array(array)
    made[len(made) // 2, -1] = value
    return made


def cases(draw, folder):
    """Yield a door, and what is changed of the controls that go through it."""
    runs = written(folder / "pushed"), written(folder / "free", FREE)
    child = trained(folder / "cart", *SMALL, "system.steps=40")
    assert child.code() == 0, child.said()
    kinds = ["predict"] * 3 + ["rollout"] * 3 + ["given"] * 2 + ["files"] * 4 + ["field"] * 3 + ["steered"]
    while True:
        kind, seed, place = draw.choice(kinds), draw.randrange(10**6), Path(tempfile.mkdtemp(dir=folder))
        name = draw.choice([*NUMBERS, *["nothing"] * 12, *["large", "of each start"] * 2])
        layout = draw.choice(list(LAYOUTS)) if name in GOOD else "numpy"
        layout = "numpy" if name == "large" and layout == "integers" else layout
        if draw.random() < 0.04:
            words = draw.sample(AGAIN, draw.randint(1, 2))
            yield f"evaluation, {words}", partial(evaluated, place, folder / "cart", words)
        elif kind in ("predict", "rollout"):
            act = {"predict": predicted, "rollout": rolled}[kind]
            run = draw.choice([runs[0], runs[0], runs[0], runs[1]])
            linear = draw.random() < 0.4
            yield (
                f"{kind}, {name}, {layout}, {run.name}, linear {linear}",
                partial(act, run, name, layout, seed, linear),
            )
        elif kind == "given":
            names = draw.choice(
                [
                    ("u", "w"),
                    ("u", "w"),
                    ("u", "w"),
                    (),
                    ("u",),
                    ("u", "u"),
                    ("q", "u"),
                    ("", "u"),
                    ("u", 7),
                    "uw",
                    None,
                ]
            )
            yield f"given, {name}, {layout}, {names}", partial(brought, name, layout, seed, names)
        elif kind == "files":
            what = draw.choice(list(COLUMNS))
            cell = draw.choice(CELLS)
            yield f"files, {what}, {cell}", partial(read, place, what, cell, seed)
        elif kind == "steered":
            yield f"steered, {name}", partial(followed, runs[0], name, seed)
        else:
            field = draw.choice(list(FIELDS))
            value = draw.choice([*FIELDS[field], *ODD[:2]])
            yield f"{field} {value}", partial(stored, place, field, value)


def drawn(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return times (T,) and controls (T, 2) that bfloat16 holds."""
    draw = np.random.default_rng(seed)
    return draw.integers(1, 9, count).cumsum() / 16.0, draw.integers(-8, 8, (count, 2)).astype(float)


def expect(run: Path, name: str, layout: str) -> None:
    """Assert that what came through may do so."""
    takes = run.name == "pushed"
    assert name in GOOD if takes else name == "none", "accepted"
    assert not takes or layout != "sparse", "a sparse tensor is accepted"


def is_sound(run: Path, name: str, layout: str) -> bool:
    """Return whether controls must pass."""
    small = layout == "numpy" or name != "large"
    return (name in GOOD and layout != "sparse" and small) if run.name == "pushed" else name == "none"


def predicted(run: Path, name, layout, seed, linear) -> None:
    """Predict two starts."""
    times, base = drawn(seed, 7)
    given = NUMBERS[name](base)
    given = LAYOUTS[layout](given) if name in GOOD else given
    with taken(is_sound(run, name, layout)):
        found = ahnn.load(run).predict([[0.3, -0.2], [0.0, 1.0]], times, controls=given, linear=linear).states
    expect(run, name, layout)
    moved(
        found, times, base * (1e100 if name == "large" else 1.0) if run.name == "pushed" else 0 * base, linear
    )


def moved(found: torch.Tensor, times: np.ndarray, controls: np.ndarray, linear: bool) -> None:
    """Hold the paths of two starts against the motion in closed form."""
    for k, start in enumerate(((0.3, -0.2), (0.0, 1.0))):
        truth = Table(times, controls, linear).moved(times, start)
        size = np.abs(truth).max(axis=0) + 1e-12
        worst = float((np.abs(found[k].numpy() - truth) / size).max())
        assert worst < 1e-9, f"another motion, by {worst:.1e}"


def rolled(run: Path, name, layout, seed, linear) -> None:
    """Roll out two starts in steps of one length, or of several."""
    _, base = drawn(seed, 7)
    given = NUMBERS[name](base)
    given = LAYOUTS[layout](given) if name in GOOD else given
    lengths = np.full(7, STEP) if linear else np.linspace(0.1, 0.4, 7)
    dt = None if linear else np.stack((lengths, lengths))
    with taken(is_sound(run, name, layout)):
        found = ahnn.load(run).rollout(
            [[0.3, -0.2], [0.0, 1.0]], 7, dt, start_time=float(seed % 5), controls=given
        )
    expect(run, name, layout)
    times = np.concatenate(([0.0], lengths.cumsum()))
    base = base * (1e100 if name == "large" else 1.0) if run.name == "pushed" else 0 * base
    moved(found, times, np.concatenate((base, base[-1:])), linear=False)


def followed(run: Path, name, seed) -> None:
    """Step along a flow whose controls are known."""
    times, base = drawn(seed, 7)
    with taken(name in GOOD):
        flow = steered(ahnn.load(run).dynamics, times, NUMBERS[name](base))
    x = torch.tensor([[0.3, -0.2], [0.0, 1.0]], dtype=torch.float64)
    path = [x]
    for begin, dt in zip(times, np.diff(times), strict=False):
        path.append(at(flow, float(begin))(path[-1], float(dt)))
    found = torch.stack(path, dim=1)
    assert name in (*GOOD, "of one start", "huge"), "accepted"
    if name in GOOD:
        moved(found, times, base * (1e100 if name == "large" else 1.0), linear=False)


def brought(name, layout, seed, names) -> None:
    """Give trajectories with controls to a training."""
    times, base = drawn(seed, 9)
    states = np.random.default_rng(seed).normal(size=(2, 9, 2))
    given = NUMBERS[name](base)
    given = LAYOUTS[layout](given) if name in GOOD else given
    if name in ("nothing", "large"):
        given = LAYOUTS[layout](np.stack((base,) * 2) * (1e100 if name == "large" else 1.0))
    source = Given(
        Trajectories(torch.tensor(states), torch.tensor(times), given), SPACE._replace(controls=names)
    )
    found = source.read().controls
    if found is None:
        assert name == "none" and not names, "controls are dropped"  # noqa: PT018
        return
    assert name in GOOD, "accepted"
    assert names == ("u", "w"), "names that are none are accepted"
    told = np.stack((base,) * 2) * (1e100 if name == "large" else 1.0)
    assert np.allclose(found.numpy(), told, rtol=1e-2 if "16" in layout or "int" in layout else 1e-6), (
        "other controls"
    )


def column(texts: list[str], at_row: int, text: str) -> list[str]:
    """Return a column with another cell."""
    return [*texts[:at_row], text, *texts[at_row + 1 :]]


COLUMNS = {
    "u, u2": ("t [s],q [m],v [m/s],u,u2", "same"), "u1, u2": ("t [s],q [m],v [m/s],u1,u2", "same"),
    "torque": ("t [s],q [m],v [m/s],torque [Nm],control_2", "same"), "first": ("u,u2,t [s],q [m],v [m/s]", "same"),
    "commands": ("t [s],q [m],v [m/s],cmd,INPUT_b", "same"), "twice": ("t [s],q [m],v [m/s],u,u", "refused"),
    "a cell": ("t [s],q [m],v [m/s],u,u2", "cell"), "a cell, linear": ("t [s],q [m],v [m/s],u,u2", "cell"),
    "linear": ("t [s],q [m],v [m/s],u,u2", "same"), "named": ("t,a,b,c,d", "same"), "named twice": ("t,a,b,c,d", "refused"),
    "named, gone": ("t,a,b,c,d", "refused"), "no list": ("t,a,b,c,d", "refused"), "cubic": ("t [s],q [m],v [m/s],u,u2", "refused"),
    "other units": ("t [s],q [m],v [m/s],u [N],u2 [N]", "refused"), "other names": ("t [s],q [m],v [m/s],u,u2", "refused"),
    "other rule": ("t [s],q [m],v [m/s],u,u2", "refused"), "a unit that is none": ("t [s],q [m],v [m/s],u [furlong],u2 [x/]", "same"),
}  # fmt: skip
"""Headers of trajectories with controls, and what must become of them."""
ROLES = {"time": "t", "positions": ["a"], "velocities": ["b"]}
SIDECARS = {
    "linear": {"controls": "linear"}, "a cell, linear": {"controls": "linear"}, "cubic": {"controls": "cubic"}, "other rule": {"controls": "linear"},
    "named": {"columns": {**ROLES, "controls": ["c", "d"]}}, "named twice": {"columns": {**ROLES, "controls": ["c", "b"]}},
    "named, gone": {"columns": {**ROLES, "controls": ["c", "e"]}}, "no list": {"columns": {**ROLES, "controls": {"c": 1}}},
}  # fmt: skip
SECOND = {
    "other units": ("u [N],u2 [N]", "u [kN],u2 [N]"),
    "other names": ("u,u2", "u,u3"),
    "other rule": ("u,u2", "u,u2"),
}
"""Headers of a second file that does not fit the first."""


def read(place: Path, what, cell, seed) -> None:
    """Read trajectories with columns of controls, as a training does."""
    head, expected = COLUMNS[what]
    times, base = drawn(seed, 12)
    times = times.round(1).cumsum() if what == "linear" else 0.25 * np.arange(12)
    motion = np.stack((times, np.cos(times), -np.sin(times)), axis=1)
    names = head.split(",")
    ours = 0 if names[0] == "u" else 3
    table = np.insert(motion, [ours] * 2, base, axis=1)
    columns = [[*map(repr, map(float, one))] for one in table.T]
    if expected == "cell":
        columns[ours + seed % 2] = column(columns[ours + seed % 2], seed % 12, cell)
    lines = [head, *(",".join(row) for row in zip(*columns, strict=True))]
    paths = [place / "mine.csv"]
    paths[0].write_text("\n".join(lines) + "\n")
    if what in SIDECARS:
        paths[0].with_suffix(".yaml").write_text(str(SIDECARS[what]))
    if what in SECOND:
        paths.append(place / "other.csv")
        paths[1].write_text("\n".join([head.replace(*SECOND[what]), *lines[1:]]) + "\n")
    with taken(expected == "same"), heard() as said:
        files = Files("mine", [*map(str, paths)], MASS)
    assert expected == "same", f"accepted; it says {sorted(said)}"
    found = files.read()
    assert found.controls is not None, f"no controls; it says {sorted(said)}"
    there = found.present[0].numpy()
    assert np.array_equal(found.controls[0].numpy()[there], base), "other controls"
    assert np.allclose(found.times[0].numpy()[there], times), "other times"
    assert found.linear == (what == "linear"), "another rule between samples"


def stored(place: Path, field, value) -> None:
    """Load a run whose fields are of another kind, and predict with it."""
    about = {"dynamics": spec(), "space": SPACE._asdict()}
    known = {"dynamics": about["dynamics"], "space": None}
    if field.startswith("space"):
        run = (
            written(place / "pushed", SPACE._replace(controls=value), spec())
            if isinstance(value, list)
            else None
        )
        if run is None:
            return
    else:
        run = written(place / "pushed", SPACE, changed(copy.deepcopy(known), field, value)["dynamics"])
    ahnn.load(run).predict([0.3, -0.2], [0.0, 0.5], controls=[[1.0, 0.5], [1.0, 0.5]])
    assert value == [[1e300, 1e300]], "accepted"


def evaluated(place: Path, run: Path, words) -> None:
    """Evaluate a run of a cart that is pushed, with filters, under other pushes."""
    more = [
        "plugins=ukf",
        "plugins.ukf.cadence=10",
        "plugins.ukf.process_noise=[1e-3,1e-3]",
        "name=again",
        "evaluation=scores",
    ]
    answered(*enter(place, "evaluate", f"run={run}", *more[:-1], *words, limit=120.0))
