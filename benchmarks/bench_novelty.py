"""Error of a learned force outside the training data, over the novelty of the state.

python benchmarks/bench_novelty.py [NAME]

Six orbits of each kind on which a pretrained model was not trained; root mean square of the relative error of
the force over single steps, by the novelty of states.
"""

from __future__ import annotations

import dataclasses
import sys
from itertools import pairwise

import torch

import ahnn
from ahnn.data import Simulated
from ahnn.systems import Molniya

KINDS = {
    "of the training's kind": {},
    "altitude 2,000 km": {"altitude": (2000.0, 2000.0)},
    "eccentricity 0.83": {"eccentricity": (0.83, 0.83)},
    "eccentricity 0.6": {"eccentricity": (0.6, 0.6)},
    "eccentricity 0.5": {"eccentricity": (0.5, 0.5)},
    "inclination 50 degrees": {"inclination": (50.0, 50.0)},
}
EDGES = (0.0, 1.0, 2.0, 4.0, 8.0, float("inf"))


def main(name: str = "molniya_mechanical") -> None:
    """Print a row for each kind of orbit and a column for each range of novelty."""
    run = ahnn.load(name)
    options = {key: value for key, value in run.config["system"].items() if key != "_target_"}
    system = Molniya(**{key: tuple(v) if isinstance(v, list) else v for key, v in options.items()})
    print(f"{name}: relative error of the force, novelty up to 1, 2, 4, 8 and above; largest novelty")
    for kind, changes in KINDS.items():
        source = Simulated(
            dataclasses.replace(system, **changes), trajectories=6, seed=5, cache="~/.cache/ahnn"
        )
        states = source.read().states
        before, after = states[:, :-1].flatten(0, 1), states[:, 1:].flatten(0, 1)
        predicted = run.flow(before)
        error = (after - predicted)[:, 3:].norm(dim=-1) / (predicted - before)[:, 3:].norm(dim=-1)
        novelty, cells = run.novelty(before), []
        for low, high in pairwise(EDGES):
            chosen = (novelty > low) & (novelty <= high)
            rms = float(error[chosen].square().mean().sqrt()) if bool(chosen.any()) else None
            cells.append("" if rms is None else f"{rms:.1e}")
        print(f"{kind:24s}" + "".join(f"{cell:>10s}" for cell in cells) + f"{float(novelty.max()):>8.2f}")


if __name__ == "__main__":
    torch.set_num_threads(1)
    main(*sys.argv[1:])
