"""A day of 2,500 orbits about an oblate planet, a state each minute: ahnn, heyoka, and SciPy's DOP853.

    python benchmarks/bench_generation.py [repeats]

CPU seconds on one thread, in turn, and the largest error of a position against Taylor series of heyoka at
tolerance 1e-18, on some of the orbits. The tolerances of the peers give errors of about 1e-8 km, or are the
smallest accepted. heyoka integrates a vector of orbits at a time; its compilation is not counted. DOP853
integrates one orbit at a time: it integrates a few, and its time is scaled to the full number.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from statistics import median

import numpy as np
import torch
from timing import has, in_turn, left_out, markdown, ratio, settle, shown
from torch import Tensor

from ahnn.data.generate import generate
from ahnn.systems import Molniya

ORBITS, SEED, JUDGED, FEW = 2500, 1, 16, 5
NEEDS = {"heyoka": ("heyoka",)}
SYSTEM = Molniya(
    name="molniya",
    mass=1.0,
    dt=60.0,
    steps=1440,
    periods=None,
    altitude=(540.0, 560.0),
    eccentricity=(0.7, 0.8),
    inclination=(60.0, 66.0),
    raan=(0.0, 0.0),
    argument_of_periapsis=(270.0, 270.0),
)
GRID = SYSTEM.dt * np.arange(SYSTEM.steps + 1)
Orbits = Callable[[np.ndarray], np.ndarray]
"""From starts (B, 6) to states (B, T, 6)."""


def heyoka_orbits(tolerance: float) -> Orbits:
    """Return Taylor series of adaptive order and step, a vector of orbits at a time."""
    import heyoka as hy

    q, p = hy.make_vars("x", "y", "z"), hy.make_vars("u", "v", "w")
    square = q[0] ** 2 + q[1] ** 2 + q[2] ** 2
    bulge, sine2 = 1.5 * SYSTEM.j2 * SYSTEM.r_eq**2 / square, q[2] ** 2 / square
    central = -SYSTEM.mu * square**-1.5
    along = zip(q, (1.0, 1.0, 3.0), strict=True)
    force = [central * x * (1.0 + bulge * (own - 5.0 * sine2)) for x, own in along]
    motion = [*zip(q, p, strict=True), *zip(p, force, strict=True)]
    width = hy.recommended_simd_size()
    integrator = hy.taylor_adaptive_batch(motion, np.zeros((6, width)), tol=tolerance)
    grid = np.repeat(GRID[:, None], width, axis=1)

    def orbits(start: np.ndarray) -> np.ndarray:
        found = np.empty((len(start), len(GRID), 6))
        for first in range(0, len(start), width):
            rows = start[np.minimum(np.arange(first, first + width), len(start) - 1)]
            integrator.set_time(0.0)
            integrator.state[:] = rows.T
            states = integrator.propagate_grid(grid)[-1]
            part = found[first : first + width]
            part[:] = states.transpose(2, 0, 1)[: len(part)]
        return found

    return orbits


def scipy_orbits(tolerance: float) -> Orbits:
    """Return DOP853 with its dense output, one orbit at a time."""
    from scipy.integrate import solve_ivp

    mu, flattening = SYSTEM.mu, 1.5 * SYSTEM.j2 * SYSTEM.r_eq**2

    def field(_: float, s: np.ndarray) -> tuple[float, ...]:
        x, y, z, u, v, w = s.tolist()
        square = x * x + y * y + z * z
        bulge, sine2 = flattening / square, z * z / square
        central = -mu / (square * square**0.5)
        planar = central * (1 + bulge * (1 - 5 * sine2))
        return u, v, w, planar * x, planar * y, (planar + 2 * central * bulge) * z

    def orbits(start: np.ndarray) -> np.ndarray:
        span = GRID[0], GRID[-1]
        found = (solve_ivp(field, span, x, "DOP853", GRID, rtol=tolerance, atol=tolerance) for x in start)
        return np.stack([solution.y.T for solution in found])

    return orbits


def start() -> Tensor:
    """Return the states (B, 6) that `generate` begins with."""
    return SYSTEM.initial_states(ORBITS, torch.Generator().manual_seed(SEED))


def contestants(begin: np.ndarray) -> dict[str, tuple[Callable[[], np.ndarray], float]]:
    """Return the generators, each with the factor by which its work is smaller than the full work."""
    does: dict[str, tuple[Callable[[], np.ndarray], float]] = {
        "ahnn": (lambda: generate(SYSTEM, ORBITS, SEED).states.numpy(), 1.0)
    }
    if has(NEEDS["heyoka"]):
        series = heyoka_orbits(1e-14)
        does["heyoka, 1e-14"] = (lambda: series(begin)), 1.0
    method = scipy_orbits(1e-13)
    does["SciPy DOP853, 1e-13"] = (lambda: method(begin[:FEW])), ORBITS / FEW
    return does


def generation(repeats: int) -> str:
    """Return the table of times, and of errors where heyoka is there to judge them."""
    begin = start().numpy()
    does = contestants(begin)
    exact = heyoka_orbits(1e-18)(begin[:JUDGED]) if has(NEEDS["heyoka"]) else None
    row = in_turn("generation", {who: work for who, (work, _) in does.items()}, repeats)
    lines = []
    for who, (work, factor) in does.items():
        times, error = [factor * t for t in row.times[who]], ""
        if exact is not None:
            found = work()[:JUDGED, :, :3]
            error = f"{np.linalg.norm(found - exact[: len(found), :, :3], axis=-1).max():.1e}"
        beside = "" if who == "ahnn" else shown(ratio(row.times["ahnn"], times))
        lines.append([who, shown(median(times)), beside, error])
    return markdown(("a day of 2,500 orbits", "CPU [s]", "ahnn / peer", "largest error [km]"), lines)


def main() -> None:
    """Print the table."""
    settle()
    left_out(NEEDS)
    print(generation(int(sys.argv[1]) if len(sys.argv) > 1 else 7))


if __name__ == "__main__":
    main()
