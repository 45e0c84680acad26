"""Hénon-Heiles from one noisy orbit of 161 states (Ross & Heinonen 2023)."""

from __future__ import annotations

from functools import partial

import torch
from torch import Tensor

from ahnn.rollouts import rollout
from ahnn.systems import HenonHeiles
from ahnn.systems.truth import exact_flow
from ahnn.tasks.definition import Draw, FieldTask, Predict, numbers, states
from ahnn.tasks.shooting_fit import fitted_start
from ahnn.types import Trajectories

COUPLING = 0.8
"""Coupling mu in H = (p^2 + q^2) / 2 + mu (x^2 y - y^3 / 3); states times mu follow the motion for mu = 1."""
DURATION, RATE, TESTED_RATE = 40.0, 4, 10
NOISE_VARIANCE = 0.05
"""Noise variance relative to the variance of each component."""
HORIZONS = (21, 61, 161)
"""Successive numbers of samples for fits of the start: 5, 15 and 40 units of time."""
PIECES = 7
"""Number of pieces of 23 samples each."""
SYSTEM = HenonHeiles(name="henon_heiles", dt=1 / RATE, steps=round(2 * DURATION * RATE))


def begin(draw: int) -> Tensor:
    """Return a start (1, 4) for mu = 0.8, uniform in [-1, 1]^4 with bounded motion."""
    generator = numbers(draw)
    while True:
        x = states(generator.uniform(-1, 1, (1, 4)))
        if float(SYSTEM.energy(COUPLING * x)) < 1 / 6:
            return x


def true_motion(x: Tensor, steps: int, dt: float) -> Tensor:
    """Propagate states (B, 4) exactly; return (B, steps + 1, 4)."""
    return rollout(exact_flow(SYSTEM), COUPLING * x, dt, steps + 1) / COUPLING


def draw(k: int) -> Draw:
    """Draw one noisy orbit; the score is the error of its continuation from the best-fitting start.

    Training uses pieces of the orbit with separate starts, since shooting over the entire orbit does not
    converge. The same orbit serves for validation and test, as there are no other data.
    """
    start = begin(k)
    with torch.no_grad():
        exact = true_motion(start, round(DURATION * RATE), 1 / RATE)[0]
        later = true_motion(start, round(2 * DURATION * TESTED_RATE), 1 / TESTED_RATE)[0]
    sd = NOISE_VARIANCE**0.5 * exact.std(0, correction=0)
    noisy = exact + sd * states(numbers(k, 1).standard_normal(exact.shape))
    unit = noisy.std(0, correction=0)
    ahead = slice(round(DURATION * TESTED_RATE) + 1, None)

    def score(predict: Predict) -> float:
        def scaled(x: Tensor, steps: int, dt: float) -> Tensor:
            return predict(x * unit, steps, dt) / unit

        with torch.no_grad():
            begun = fitted_start(scaled, noisy / unit, 1 / RATE, HORIZONS)
            found = scaled(begun[None], len(later) - 1, 1 / TESTED_RATE)[0]
        return float((found - later / unit)[ahead].square().mean().sqrt())

    times = torch.arange(len(noisy), dtype=torch.float64) / RATE
    states_thrice, times_thrice = (torch.cat(3 * [x.unflatten(0, (PIECES, -1))]) for x in (noisy, times))
    return Draw(
        Trajectories(states_thrice, times_thrice),
        SYSTEM.space,
        (1 / 3, 1 / 3, 1 / 3),
        score,
        (f"data.noise={sd.tolist()}", "system.unsound=true"),  # copies would otherwise be treated as leakage
        partial(score, true_motion),
    )


STAGES = "loss.stages=[[4,0.3],[11,0.7],[whole,1.0]]"
MEASURED = ("sensor=recorded", "recipe=measurements", "data.measured=state", STAGES)
WAVES = "network=gaussian_process"
TASK = FieldTask(
    "Hénon-Heiles, mu 0.8, from one orbit of 161 noisy states",
    "magnusross/hgp, MIT; Ross & Heinonen 2023, TMLR",
    f"root mean squared error on ({DURATION:g}, {2 * DURATION:g}] in standard deviations of the data, from "
    "the best-fitting initial state",
    "the noise level is known here; floor: true equations from the best-fitting initial state",
    {},
    {
        "network": ("model=hnn", *MEASURED),
        "gaussian_process": ("model=hnn", WAVES, *MEASURED),
        "mechanical_gp": ("model=hnn", WAVES, "hamiltonian=mechanical", *MEASURED),
    },
    draw,
)
