"""Scales: the same data in other units give the same result in other units.

Positions, times and masses are multiplied with powers of two, which floating point numbers do exactly: lengths and
times by 1e-12 to 1e12, masses by 1e-6 to 1e6. What is drawn in other units of a file differs by rounding alone.
"""

from __future__ import annotations

import csv
import math
import tempfile
from functools import cache, partial
from pathlib import Path

import numpy as np
import torch

import ahnn
from ahnn.data import Given
from ahnn.data.doctor import examine
from ahnn.data.files import Files
from ahnn.data.files.reading import FileReading
from ahnn.data.noise_floor import noise_floor
from ahnn.dynamics import make_dynamics
from ahnn.estimation import Gate, initial_belief
from ahnn.measurements import Position
from ahnn.rollouts import rollout
from ahnn.statistics import Statistics
from ahnn.types import Space, Trajectories, Units
from ahnn_plugins.ukf import SQUARE_ROOT, STANDARD, unscented_filter

from .doors import FIXES, MODEL, START, answered, assimilating, enter, fixes, numbers

CLOSE = 1e-9
"""Relative difference of what is computed in a few steps."""
LEARNED = 0.02
"""Relative difference of the scores of trainings: rounding grows in an optimiser."""
SINGLE = 40
"""Exponent of momenta at most, in trainings: their squares are numbers of single precision."""
LENGTHS = {"km": 1.0, "m": 1e-3, "cm": 1e-5, "mm": 1e-6, "um": 1e-9, "AU": 149597870.7}
CLOCKS = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
FIT = ["model=hnn", "recipe=first_order", "trainer.max_epochs=2", "data.batch_size=16", "model.network.width=8",
       "data.windows_per_epoch=160", "data.val_windows=40", "evaluation=scores", "evaluation.figures=false",
       "plugins=none", "logger=none", "trainer.accelerator=cpu", "data.split=[0.6,0.2,0.2]"]  # fmt: skip
RECIPES = {
    "first order": FIT,
    "second order": [word for word in FIT if "recipe" not in word],
    "windows": [*FIT[1:], "model=ahnn", "window=3"],
    "64 bits": [*FIT, "data.precision=64"],
    "node": [*FIT[1:], "model=node"],
    "mlp": [*FIT[1:], "model=mlp"],
}


class Scale:
    """Factors of positions, times, masses, and of the momenta that follow.

    Args:
        position, time, mass: exponents of two.
    """

    def __init__(self, position: int, time: int, mass: int) -> None:
        self.position, self.time, self.mass = 2.0**position, 2.0**time, 2.0**mass
        self.momentum = self.mass * self.position / self.time

    def states(self, x: torch.Tensor) -> torch.Tensor:
        """Return states [q, p] in the other units."""
        q, p = x.chunk(2, dim=-1)
        return torch.cat((q * self.position, p * self.momentum), dim=-1)

    def data(self, base: Trajectories) -> Trajectories:
        """Return trajectories in the other units."""
        return Trajectories(self.states(base.states), base.times * self.time)

    def __str__(self) -> str:
        return f"lengths {self.position:.0e}, times {self.time:.0e}, masses {self.mass:.0e}"


def cases(draw, folder):
    """Yield a computation and a scale."""
    kinds = [
        "statistics",
        "dynamics",
        "dynamics",
        "filter",
        "filter",
        "filter",
        "table",
        "table",
        "start",
        "stream",
    ]
    while True:
        scale = Scale(draw.randint(-40, 40), draw.randint(-40, 40), draw.randint(-20, 20))
        kind, seed = draw.choice(kinds), draw.randrange(10**6)
        place = Path(tempfile.mkdtemp(dir=folder))
        if draw.random() < 0.03:
            name = draw.choice(list(RECIPES))
            while not 2.0**-SINGLE <= scale.momentum <= 2.0**SINGLE:
                scale = Scale(draw.randint(-40, 40), draw.randint(-40, 40), draw.randint(-20, 20))
            yield f"training, {name}, {scale}", partial(learned, place, name, scale)
        elif kind == "dynamics":
            spec = {"hamiltonian": draw.choice(["generic", "separable", "mechanical"]), "dof": draw.randint(1, 3),
                    "scaling": draw.choice(["block", "minmax"]), "inputs": draw.choice(["cartesian", "isotropic"]),
                    "integrator": draw.choice(["rk4", "dopri5", "gl4"])}  # fmt: skip
            yield f"dynamics {[*spec.values()]}, {scale}", partial(propagated, spec, scale, seed)
        elif kind in ("start", "stream"):
            length, clock = draw.choice(list(LENGTHS)), draw.choice(list(CLOCKS))
            shift = draw.choice([0.0, 0.0, 1.0, 2.0**20, 2.0**30])
            act = (
                partial(started, place, length, clock)
                if kind == "start"
                else partial(streamed, place, length, clock, shift)
            )
            yield f"{kind} in {length} and {clock}" + f", {shift:.0e} s later" * (kind == "stream"), act
        else:
            act = {"statistics": described, "filter": filtered, "table": partial(tabled, place)}[kind]
            yield f"{kind}, {scale}", partial(act, scale, seed)


def swings(seed: int, dof: int = 1, noise: float = 0.0, mass: float = 1.0) -> Trajectories:
    """Return oscillations of several sizes, (12, 25, 2n)."""
    draw = torch.Generator().manual_seed(seed)
    t = 0.125 * torch.arange(25, dtype=torch.float64)
    phase = 6 * torch.rand(12, 1, dof, generator=draw, dtype=torch.float64)
    size = 0.5 + torch.rand(12, 1, dof, generator=draw, dtype=torch.float64)
    angle = t[:, None] + phase
    states = torch.cat((size * angle.cos(), -mass * size * angle.sin()), dim=-1)
    states = states + noise * torch.randn(states.shape, generator=draw, dtype=torch.float64)
    return Trajectories(states, t.expand(12, -1))


def off(found: torch.Tensor, expected: torch.Tensor) -> float:
    """Return the largest difference, relative to the largest number."""
    return float((found - expected).abs().max() / expected.abs().max())


def described(scale: Scale, seed: int) -> None:
    """Compute statistics and the level of noise."""
    base = swings(seed, 2, 1e-3)
    other = Given(scale.data(base), Space("mine", ("x", "y", "px", "py"), inertia=scale.mass)).read()
    one, two = Statistics.of(base), Statistics.of(other)
    for name in ("minimum", "maximum", "increment"):
        assert torch.equal(getattr(two, name), scale.states(getattr(one, name))), name
    assert two.dt == one.dt * scale.time, "dt"
    assert off(two.forces, one.forces * (scale.momentum / scale.time)) < CLOSE, "forces"
    assert off(noise_floor(*other[:2]), scale.states(noise_floor(*base[:2]))) < CLOSE, "level of noise"


def propagated(spec: dict, scale: Scale, seed: int) -> None:
    """Propagate with fresh weights that were calibrated to the data."""
    base, found = swings(seed, spec["dof"]), []
    for one, data in ((Scale(0, 0, 0), base), (scale, scale.data(base))):
        torch.manual_seed(seed)
        made = {
            **spec,
            "kind": "hamiltonian",
            "inertia": one.mass,
            "mu": None,
            "integrator": {"name": spec["integrator"]},
        }
        dynamics = make_dynamics(**made, network={"width": 8, "depth": 2, "activation": "tanh"}).double()
        dynamics.fit(Statistics.of(data))
        with torch.no_grad():
            found.append(rollout(dynamics, data.states[:, 0], 0.125 * one.time, 12))
    q, p = found[1].chunk(2, dim=-1)
    expected = scale.states(found[0]).chunk(2, dim=-1)
    assert bool(found[1].isfinite().all()), "not finite"
    assert max(off(q, expected[0]), off(p, expected[1])) < CLOSE, (
        f"{off(q, expected[0]):.1e}, {off(p, expected[1]):.1e}"
    )


def filtered(scale: Scale, seed: int) -> None:
    """Filter positions of an oscillator, with a gate or without."""
    draw = torch.Generator().manual_seed(seed)
    rows = torch.randn(2, 15, 1, generator=draw, dtype=torch.float64)
    rows[:, ::4] = torch.nan
    turn = torch.tensor([[0.9, 0.3], [-0.5, 0.9]], dtype=torch.float64)
    form, gate = (STANDARD, SQUARE_ROOT)[seed % 2], Gate(0.99) if seed % 3 == 0 else None

    def run(one: Scale):
        size = torch.tensor([one.position, one.momentum], dtype=torch.float64)
        step = size[:, None] * turn / size
        square = torch.outer(size, size)
        belief = initial_belief(torch.zeros(2, 2), torch.eye(2, dtype=torch.float64) * square)
        noise, error = 0.1 * torch.eye(2, dtype=torch.float64) * square, 0.5 * one.position**2 * torch.eye(1)
        bent = lambda x, _: x + 0.1 * size * ((x / size).sin() @ turn.mT)  # noqa: E731
        flow = bent if seed % 5 == 0 else lambda x, _: x @ step.mT
        return unscented_filter(flow, belief, rows * one.position, Position(1), noise, error.double(), one.time,
                                form=form, gate=gate)  # fmt: skip

    base, other = run(Scale(0, 0, 0)), run(scale)
    assert base.status.tolist() == other.status.tolist(), (
        f"status {base.status.tolist()} and {other.status.tolist()}"
    )
    for k, size in enumerate((scale.position, scale.momentum)):
        worst = off(other.means[..., k] / size, base.means[..., k])
        assert worst < CLOSE, f"component {k} off by {worst:.1e}"


def tabled(place: Path, scale: Scale, seed: int) -> None:
    """Read and examine a table without units."""
    base, found = swings(seed), []
    for name, data in (("a", base), ("b", Scale.data(Scale(0, 0, 0), base)), ("c", scale.data(base))):
        factor = scale.mass if name == "c" else 1.0
        rows = [(f"r{b}", float(t), *(float(v) for v in (x[0], x[1] / factor)))
                for b in range(12) for k, (t, x) in enumerate(zip(data.times[b], data.states[b], strict=True))
                if k != 7 + b % 5]  # fmt: skip
        (place / name).mkdir()
        path = fixes(place / name / "mine.csv", rows, "id,t,q,v")
        files = Files("mine", str(path), mass=factor)
        findings = examine([path], FileReading(), None, 10.0).findings
        found.append((files.read(), [(one.level, one.row, one.column) for one in findings]))
    (one, said), _, (two, then) = found
    assert said == then, f"the check finds {then[:3]} for {said[:3]}"
    assert one.states.shape == two.states.shape, (
        f"{tuple(two.states.shape)} samples, not {tuple(one.states.shape)}"
    )
    assert torch.equal(scale.states(one.states).nan_to_num(), two.states.nan_to_num()), "other states"
    assert off(two.times, one.times * scale.time) < CLOSE, "other times"


def table_of(path: Path) -> tuple[list[str], np.ndarray]:
    """Return names and numbers of an output."""
    with path.open() as file:
        rows = list(csv.reader(file))
    return rows[0], np.array(
        [[float(cell) if cell and not cell[0].isalpha() else math.nan for cell in row] for row in rows[1:]]
    )


def started(place: Path, length: str, clock: str) -> None:
    """Predict from a file in other units."""
    found = []
    for name, a, b in (("a", "km", "s"), ("b", length, clock)):
        (place / name).mkdir()
        head = f"t [{b}],x [{a}],y [{a}],z [{a}],vx [{a}/{b}],vy [{a}/{b}],vz [{a}/{b}]"
        state = [x / LENGTHS[a] for x in START[:3]] + [v / LENGTHS[a] * CLOCKS[b] for v in START[3:]]
        rows = [(k * 60.0 / CLOCKS[b], *state) for k in range(2)]
        path = fixes(place / name / "start.csv", rows, head)
        answered(
            *enter(place, "predict", MODEL, f"start={path}", "duration=20min", f"output={place}/{name}.csv")
        )
        found.append(table_of(place / f"{name}.csv"))
    assert found[0][0] == found[1][0], "other columns"
    same(found[0][1], found[1][1], CLOSE)


def same(one: np.ndarray, other: np.ndarray, limit: float) -> None:
    """Assert columns that differ by rounding alone."""
    assert one.shape == other.shape, f"{other.shape} numbers, not {one.shape}"
    size = np.nanmax(np.abs(one), axis=0, initial=0) + 1e-12
    worst = np.nanmax(np.abs(one - other) / size, initial=0)
    assert worst < limit, f"other numbers, by {worst:.1e}"


def streamed(place: Path, length: str, clock: str, shift: float) -> None:
    """Assimilate measurements in other units, and with another zero of time."""
    found = []
    for name, a, b, zero in (("a", "km", "s", 0.0), ("b", length, clock, shift)):
        (place / name).mkdir()
        rows = [((t + zero) / CLOCKS[b], *(v / LENGTHS[a] for v in rest)) for t, *rest in FIXES]
        path = fixes(place / name / "fixes.csv", rows, f"time [{b}],x [{a}],y [{a}],z [{a}]")
        words = assimilating(path, f"output={place}/{name}.csv", f"time={zero!r}", f"start={numbers(START)}")
        answered(*enter(place, "assimilate", *words))
        head, table = table_of(place / f"{name}.csv")
        table[:, head.index("time")] -= zero
        keep = [k for k, title in enumerate(head) if title in ("time", "x", "y", "z", "px", "py", "pz")]
        found.append(table[:, keep])
    same(*found, 1e-6)


@cache
def scores_of(name: str, place: Path) -> list[float]:
    """Return the scores of a training in units of one."""
    return trained(place, name, Scale(0, 0, 0))


def trained(place: Path, name: str, scale: Scale) -> list[float]:
    """Train and return the scores of the first row, in units of one."""
    data = scale.data(swings(0))
    space = Space("mine", ("q", "p"), Units("s", "m", "m/s", "J"), scale.mass)
    run = ahnn.fit(data, space, RECIPES[name], folder=place / "run")
    scores = run.results.rows[0].scores
    return [scores.position / scale.position, scores.velocity / (scale.position / scale.time)]


def learned(place: Path, name: str, scale: Scale) -> None:
    """Train on data in other units."""
    base = scores_of(name, place.parent / name.replace(" ", "_"))
    for one, other in zip(base, trained(place, name, scale), strict=True):
        assert abs(one / other - 1) < LEARNED, f"scores {other:.6g}, not {one:.6g}"
