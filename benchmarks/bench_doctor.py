"""Does the data check detect wrong units and frames, and is it silent on sound data?

    python benchmarks/bench_doctor.py --cases 1000 --seed 0

Springs, pendulums and orbits (LEO, GEO, Molniya; with J2), exact or noisy, are written as tables, each once
unchanged and once with one mistake in its units or its frame. Any fault or warning counts as flagged.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from ahnn.data.doctor import Finding, examine
from ahnn.data.files.reading import FileReading

Array = NDArray[np.float64]
MU, RADIUS, J2, TURN = 398600.4418, 6378.1363, 1.0826e-3, 7.292115e-5


class Table(NamedTuple):
    """A data set: times (T,), positions and velocities (B, T, n), names with units, and its frame."""

    t: Array
    q: Array
    v: Array
    header: tuple[str, ...]
    frame: str = ""


def spring(draw: Generator) -> Table:
    """Return free oscillations in one or two dimensions."""
    n, count = int(draw.integers(1, 3)), int(draw.integers(2, 6))
    rate, size = 10 ** draw.uniform(-1, 2, n), 10 ** draw.uniform(-3, 2)
    t = times(draw, 2 * np.pi / rate.max())[:, None]
    a, phase = size * draw.uniform(0.5, 1, (count, 1, n)), draw.uniform(0, 2 * np.pi, (count, 1, n))
    q, v = a * np.cos(rate * t + phase), -a * rate * np.sin(rate * t + phase)
    names = "xy"[:n]
    return Table(t[:, 0], q, v, (*(f"{c} [m]" for c in names), *(f"v{c} [m/s]" for c in names)))


def pendulum(draw: Generator) -> Table:
    """Return swings of 10 to 150 degrees."""
    rate, count = 10 ** draw.uniform(-0.5, 1), int(draw.integers(2, 6))
    t = times(draw, 2 * np.pi / rate)
    start = np.concatenate((draw.uniform(0.17, 2.6, count), np.zeros(count)))
    field = lambda _, x: np.concatenate((x[count:], -(rate**2) * np.sin(x[:count])))  # noqa: E731
    x = solve_ivp(field, (0, t[-1]), start, "DOP853", t, rtol=1e-9, atol=1e-9).y.T
    q, v = x[:, :count].T[..., None], x[:, count:].T[..., None]
    return Table(t, q, v, ("q [rad]", "v [rad/s]"))


def orbit(
    perigee: tuple[float, float], eccentricity: tuple[float, float], tilt: tuple[float, float]
) -> Callable:
    """Return a function that draws orbits with perigee in km, eccentricity, and inclination in degrees."""

    def drawn(draw: Generator) -> Table:
        runs, low, e = [], draw.uniform(*perigee), draw.uniform(*eccentricity)
        period = 2 * np.pi * np.sqrt((low / (1 - e)) ** 3 / MU)
        t = times(draw, period * (1 - e) ** 1.5)
        for _ in range(int(draw.integers(1, 4))):
            i, node, u = np.radians(draw.uniform(*tilt)), *draw.uniform(0, 2 * np.pi, 2)
            x = np.array([np.cos(u), np.sin(u) * np.cos(i), np.sin(u) * np.sin(i)])
            y = np.array([-np.sin(u), np.cos(u) * np.cos(i), np.cos(u) * np.sin(i)])
            speed = np.sqrt(MU * (1 + e) / low)
            start = np.concatenate((spun(low * x, node), spun(speed * y, node)))
            runs.append(solve_ivp(attraction, (0, t[-1]), start, "DOP853", t, rtol=1e-9, atol=1e-6).y.T)
        q, v = np.split(np.stack(runs), 2, axis=-1)
        header = (*(f"{c} [km]" for c in "xyz"), *(f"v{c} [km/s]" for c in "xyz"))
        return Table(t, q, v, header, str(draw.choice(["", "EME2000", "GCRF, EARTH"])))

    return drawn


def attraction(_: float, x: Array) -> Array:
    """Return the derivative of a state in km and km/s under central attraction and J2."""
    q, r = x[:3], float(np.linalg.norm(x[:3]))
    factor = 1.5 * J2 * (RADIUS / r) ** 2
    return np.concatenate(
        (x[3:], -MU / r**3 * q * (1 + factor * (np.array([1, 1, 3]) - 5 * (q[2] / r) ** 2)))
    )


def spun(x: Array, angle: Array | float) -> Array:
    """Return vectors (..., 3) turned about the pole."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack((c * x[..., 0] - s * x[..., 1], s * x[..., 0] + c * x[..., 1], x[..., 2]), axis=-1)


def times(draw: Generator, period: float) -> Array:
    """Return about 20 to 200 samples a period over 0.5 to 3 periods, at least 16."""
    step = period / draw.uniform(20, 200)
    return step * np.arange(max(16, int(draw.uniform(0.5, 3) * period / step)))


DRAWN: dict[str, Callable[[Generator], Table]] = {
    "spring": spring,
    "pendulum": pendulum,
    "LEO": orbit((6700, 7500), (0.0, 0.02), (0, 100)),
    "GEO": orbit((42100, 42230), (0.0, 0.001), (0, 5)),
    "Molniya": orbit((6900, 7200), (0.7, 0.74), (60, 66)),
}


def scaled(q: float = 1.0, v: float = 1.0, t: float = 1.0) -> Callable[[Table, Generator], Table]:
    """Return the mistake of numbers that are too large by these factors."""
    return lambda one, _: one._replace(t=t * one.t, q=q * one.q, v=v * one.v)


def momentum(one: Table, draw: Generator) -> Table:
    """Take momenta for velocities, of a mass that is not about 1."""
    mass = np.exp(draw.choice([-1, 1]) * draw.uniform(np.log(1.2), np.log(500)))
    return one._replace(v=mass * one.v)


def fixed(one: Table, _: Generator) -> Table:
    """Take what turns with the Earth for inertial."""
    angle = -TURN * one.t
    q = spun(one.q, angle)
    return one._replace(q=q, v=spun(one.v, angle) - np.cross([0.0, 0.0, TURN], q))


def mixed(one: Table, draw: Generator) -> Table:
    """Combine positions that rotate with the Earth with velocities that do not."""
    return one._replace(q=fixed(one, draw).q)


COMMON = {"min as s": scaled(t=1 / 60), "s as min": scaled(t=60), "momentum as velocity": momentum}
LENGTHS = COMMON | {"mm as m": scaled(q=1e3), "km as m": scaled(q=1e-3), "mm/s as m/s": scaled(v=1e3)}
MISTAKES = {
    "spring": LENGTHS
    | {"km/s as m/s": scaled(v=1e-3), "km/h as m/s": scaled(v=3.6), "cm as m": scaled(q=100)},
    "pendulum": COMMON
    | {
        "deg as rad": scaled(q=180 / np.pi),
        "deg/s as rad/s": scaled(v=180 / np.pi),
        "deg and deg/s as rad": scaled(q=180 / np.pi, v=180 / np.pi),
    },
}
ORBITS = COMMON | {
    "m as km": scaled(q=1e3),
    "m/s as km/s": scaled(v=1e3),
    "km/s as m/s": scaled(v=1e-3),
    "m and m/s as km": scaled(q=1e3, v=1e3),
    "min and km/min as s": scaled(t=1 / 60, v=60),
    "Earth-fixed as inertial": fixed,
    "Earth-fixed positions": mixed,
    "inertial as Earth-fixed": lambda one, _: one._replace(frame="ITRF2014"),
}


def noisy(one: Table, draw: Generator) -> Table:
    """Return half of the tables with noise of 1e-6 to 1e-3 of the size of their numbers."""
    if draw.random() < 0.5:
        return one
    level = 10 ** draw.uniform(-6, -3)
    parts = [x + level * x.std() * draw.standard_normal(x.shape) for x in (one.q, one.v)]
    return one._replace(q=parts[0], v=parts[1])


def verdict(one: Table, folder: Path) -> list[Finding]:
    """Write a table and return the findings in its columns, except for notes."""
    path = folder / "data.csv"
    rows = np.concatenate(
        [
            np.column_stack((np.full(len(one.t), b), one.t, q, v))
            for b, (q, v) in enumerate(zip(one.q, one.v, strict=True))
        ]
    )
    np.savetxt(path, rows, "%.15g", ",", header=",".join(("id", "t [s]", *one.header)), comments="")
    path.with_suffix(".yaml").write_text(f"frame: {one.frame}\n" if one.frame else "{}\n")
    found = examine([path], FileReading()).findings
    return [finding for finding in found if finding.level != "note" and finding.column]


def main() -> None:
    """Draw the cases, count, and print what was not as it should be."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    flagged, alarms, drawn, missed = 0, 0, Counter[str](), Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        for case in range(args.cases):
            draw = np.random.default_rng((args.seed, case))
            kind = str(draw.choice(list(DRAWN)))
            table = noisy(DRAWN[kind](draw), draw)
            mistakes = MISTAKES.get(kind, ORBITS)
            name = str(draw.choice(list(mistakes)))
            if found := verdict(table, Path(folder)):
                alarms += 1
                print(f"case {case}, {kind}, false alarm: {found[0].column}: {found[0].what}")
            seen = bool(verdict(mistakes[name](table, draw), Path(folder)))
            flagged += seen
            drawn[f"{kind}, {name}"] += 1
            missed[f"{kind}, {name}"] += not seen
            if not seen:
                print(f"case {case}, {kind}, missed: {name}")
    for name, count in sorted(drawn.items()):
        print(f"{name:34} {count - missed[name]:4} of {count:4}")
    print(f"mislabels flagged: {flagged} of {args.cases} ({flagged / args.cases:.1%}, bar 99 %)")
    print(f"false alarms on clean sets: {alarms} of {args.cases} ({alarms / args.cases:.1%}, bar 1 %)")


if __name__ == "__main__":
    main()
