"""Silent changes: what determines a result is compared on a resume, acts in an evaluation, and keys the cache."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from functools import partial

from ahnn.cli.compose import compose_job
from ahnn.cli.prepare import prepare
from ahnn.cli.reevaluation import Request, run_config
from ahnn.data import store
from ahnn.errors import UserError
from ahnn.systems import HenonHeiles, Kepler, MassSpring, Molniya, Pendulum

from .children import TRAINING, trained

DECISIVE = {
    "seed": [8, 201],
    "window": [2, 3, 7],
    "data.trajectories": [21, 40],
    "data.seed": [1, 99],
    "data.split": ["[0.7,0.2,0.1]", "[0.6,0.2,0.2]"],
    "data.batch_size": [8, 32],
    "data.precision": [64],
    "data.windows_per_epoch": [80, 320],
    "data.val_windows": [20],
    "data.emphasis": [0.5, 1.0],
    "data.order_seed": [5],
    "system.dt": [0.02, 0.005],
    "system.steps": [50, 80],
    "system.mass": [1.5, 2.0],
    "system.stiffness": [4.0],
    "model.network.width": [9, 16],
    "model.network.depth": [1, 3],
    "model.network.activation": ["relu", "silu"],
    "model.scaling": ["minmax"],
    "integrator.name": ["leapfrog", "dopri5"],
    "loss.delta": [0.3],
    "loss.derivative": [0.5],
    "optimizer.lr": [0.1, 1e-5],
    "optimizer.weight_decay": [0.3],
    "scheduler.infimum_lr": [1e-5],
    "trainer.max_epochs": [4, 30],
    "+trainer.gradient_clip_val": [1.0],
    "+trainer.accumulate_grad_batches": [2],
    "callbacks.best.monitor": ["val/one_step"],
}
HARMLESS = {
    "label": ["other"],
    "callbacks.last.every": [7],
    "evaluation.seed": [3],
    "callbacks.telemetry.every": [9],
}
AGAIN = ["system.dt=0.02", "system.mass=2.0", "data.seed=5", "data.trajectories=30", "data.split=[0.5,0.2,0.3]",
         "evaluation.seed=4", "label=x", "threads=2", "loss.delta=0.1", "optimizer.lr=1", "model.window=3",
         "integrator.name=gl4", "data.batch_size=3", "measurement.sd=2", "system=kepler", "seed=3",
         "trainer.max_epochs=3", "data.precision=64"]  # fmt: skip
SYSTEMS = [
    MassSpring(name="s", dt=0.01, steps=9),
    Pendulum(name="p", dt=0.01, steps=9),
    Kepler(name="k", dt=0.01, steps=9),
    HenonHeiles(name="h", dt=0.01, steps=9),
    Molniya(name="m", dt=60.0, steps=9),
]


def cases(draw, folder):
    """Yield changes of a finished run, of an evaluation, and of a system."""
    run = folder / "run"
    child = trained(run)
    assert child.code() == 0, child.said()
    os.environ["AHNN_CACHE"] = str(folder / "cache")
    while True:
        kind = draw.choice(["resume", "resume", "harmless", "again", "recipe"])
        if kind in ("resume", "harmless"):
            known = DECISIVE if kind == "resume" else HARMLESS
            keys = draw.sample(list(known), draw.randint(1, 2))
            words = [f"{key}={draw.choice(known[key])}" for key in keys]
            yield f"{kind} {words}", partial(resumed, run, words, kind)
        elif kind == "again":
            words = draw.sample(AGAIN, draw.randint(1, 3))
            yield f"evaluate {words}", partial(evaluated, run, words)
        else:
            yield "recipe", partial(recipe, draw.choice(SYSTEMS), draw.random(), draw.randrange(99))


def resumed(run, words, kind) -> None:
    """Resume with a change; only what does not matter may pass."""
    keys = [word.split("=")[0].lstrip("+") for word in words]
    kept = [word for word in TRAINING if word.split("=")[0] not in keys]
    if kind == "harmless":
        prepare(compose_job([*kept, "ckpt=last", *words], run))
        return
    with contextlib.suppress(UserError):
        prepare(compose_job([*kept, "ckpt=last", *words], run))
        message = "resumed without a word"
        raise AssertionError(message)
    raise UserError(", ".join(keys))


def evaluated(run, words) -> None:
    """Evaluate again with a change: it is in the configuration that acts, or it is refused."""
    before = run_config(run, Request(run, run, "best", None, [], trust=False))
    after = run_config(run, Request(run, run, "best", None, words, trust=False))
    assert str(before) != str(after), "accepted without effect"


def recipe(system, factor, seed) -> None:
    """Another parameter is another key."""
    base = store.recipe(system, 5, seed)
    field = [f for f in dataclasses.fields(system) if isinstance(getattr(system, f.name), float)]
    chosen = field[int(factor * len(field))].name
    other = dataclasses.replace(system, **{chosen: getattr(system, chosen) * (1 + 1e-12) + 1e-12})
    assert str(store.recipe(other, 5, seed)) != str(base), f"{chosen} is not in the key"
    assert str(store.recipe(system, 6, seed)) != str(base)
    assert str(store.recipe(system, 5, seed + 1)) != str(base)
