"""A run whose predictions are known in closed form: a free body that two controls push."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ahnn.checkpoints import FORMAT, Weights, write_weights
from ahnn.dynamics import make_dynamics
from ahnn.stored import about_space
from ahnn.types import Space, Units

MASS, STEP = 1.5, 0.2
PUSH = np.array([1.0, -0.5])
"""Row of the matrix of the controls u and w."""
SPACE = Space("pushed", ("q", "p"), Units("s", "m", "m/s", "J"), inertia=MASS, controls=("u", "w"))
FREE = SPACE._replace(controls=())


class Table(NamedTuple):
    """Controls over time.

    Attributes:
        times: (T,) in seconds.
        values: (T, 2), those of each time on; the last ones are held to the end.
        linear: whether they are interpolated.
    """

    times: np.ndarray
    values: np.ndarray
    linear: bool = False

    def moved(self, times: np.ndarray, start: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
        """Return positions and momenta (K, 2) of a body that starts at the first of the times (K,)."""
        knots = np.unique(
            np.concatenate((times, self.times[(self.times > times[0]) & (self.times < times[-1])]))
        )
        begun = self._force(knots[:-1], right=True)
        ended = self._force(knots[1:], right=False)
        h, slope = np.diff(knots), (ended - begun) / np.diff(knots)
        q, p = [start[0]], [start[1]]
        for step, force, rate in zip(h, begun, slope, strict=True):
            q.append(q[-1] + (p[-1] * step + force * step**2 / 2 + rate * step**3 / 6) / MASS)
            p.append(p[-1] + force * step + rate * step**2 / 2)
        chosen = np.searchsorted(knots, times)
        return np.stack((np.array(q)[chosen], np.array(p)[chosen]), axis=1)

    def _force(self, times: np.ndarray, *, right: bool) -> np.ndarray:
        """Return the force (K,) just behind times, or just before them."""
        if self.linear:
            values = np.stack([np.interp(times, self.times, one) for one in self.values.T], axis=1)
        else:
            side = "right" if right else "left"
            values = self.values[np.searchsorted(self.times, times, side=side).clip(1) - 1]
        return values @ PUSH


def spec(controls: int = 2, matrix: list[list[float]] | None = None, **others: object) -> dict:
    """Return what `make_dynamics` takes."""
    push = {"push": {"kind": "actuation", "matrix": matrix or [[*map(float, PUSH)]]}} if controls else {}
    own = {"controls": controls, "forces": push} if controls else {}
    network = {"width": 4, "depth": 1, "activation": "tanh"}
    return {"kind": "hamiltonian", "dof": 1, "inertia": MASS, "hamiltonian": "mechanical", "mu": None,
            "inputs": "cartesian", "scaling": "none", "network": network, "integrator": {"name": "rk4"},
            **own, **others}  # fmt: skip


def written(folder: Path, space: Space = SPACE, dynamics: dict | None = None, **about: object) -> Path:
    """Write a run of a body without any potential, and return its folder."""
    made = spec(len(space.controls)) if dynamics is None else dynamics
    model = make_dynamics(**(spec(len(space.controls)) if dynamics is None else spec())).double()
    state = {name: part * (".network." not in name) for name, part in model.state_dict().items()}
    folder.mkdir(parents=True)
    beside = {"format": FORMAT, "dynamics": made, "space": about_space(space), "dt": STEP, **about}
    write_weights(folder / "weights.safetensors", Weights(state, beside))
    return folder
