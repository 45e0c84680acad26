"""Is the default recipe good enough under noise? It is compared with all other recipes.

    python benchmarks/bench_default_recipe.py --systems pendulum --out commands.csv
    python benchmarks/bench_default_recipe.py --seconds 60 --out minute.csv

Each row is one training run with a recipe named on the command line; the default is the recipe of the
experiment. By default a row is the complete command, in the time that its recipe takes. With `--seconds` all
runs have the same CPU time, 625 trajectories and no final steps on all measurements; stages, given as
fractions of the epochs, become fractions of the time. The error is the mean over unseen trajectories of the
rms vector norm, in rollouts from the true start. Rows are appended as they are measured; rows in the file are
not measured again. Each level of noise ends with the factor by which the default is worse than the best
recipe.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import json
import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import torch

from ahnn.cli.commandline import compose, config_loader
from ahnn.cli.compose import composed
from ahnn.cli.prepare import prepare
from ahnn.errors import TrainingError, UserError
from ahnn.metrics import errors, rmse_norm
from ahnn.rollouts import rollout
from ahnn.statistics import sampling_interval

LEVELS = {
    "spring": ("spring_noisy", ["0.001", "0.01"]),
    "pendulum": ("pendulum_angles", ["0.01"]),
    "orbit": ("molniya_states", ["[0.1,1e-4]", "[1.0,1e-3]"]),
    "positions": ("molniya_positions", ["0.1"]),
    "positions_mechanical": ("molniya_positions_mechanical", ["0.1"]),
}
"""Experiments, and the standard deviations of their measurements."""
RECIPES = (
    "measurements",
    "noisy_states",
    "dense_states",
    "noisy_positions",
    "second_order",
    "first_order",
    "eccentric",
)
EPOCHS = 20
"""In which stages are counted; they end when the time does."""
ENDS = {2: "refused", 3: "inf"}
"""Meaning of exit codes: measurements that do not fit the recipe, a failed training run."""
WARM = 5.0
"""Seconds of a first training run, which includes everything that happens once in a process."""


def trained(overrides: list[str], seconds: float) -> float:
    """Return the error of a training run of so many seconds of CPU time; inf if it failed.

    Raises:
        UserError: a recipe that the measurements do not fit, or a default that the command line rejects.
    """
    with tempfile.TemporaryDirectory() as folder:
        place = [f"folder={folder}", f"run={folder}", "data.trajectories=625"]
        prepared = prepare(composed("train", [*place, *overrides]))
        data, model = prepared.data, prepared.model
    statistics = data.statistics()
    model.calibrate(statistics)
    loader, optimizer = data.train_dataloader(), model.configure_optimizers()
    optimizer = optimizer["optimizer"] if isinstance(optimizer, dict) else optimizer
    data.epochs, begun, done = EPOCHS, time.process_time(), 0.0
    while done < 1:
        epoch = int(done * EPOCHS)
        loader.set_epoch(epoch)
        for batch in loader:
            objective = model.curriculum.at(epoch, EPOCHS)
            step(model, objective, batch, optimizer)
            done = (time.process_time() - begun) / seconds
            if int(done * EPOCHS) != epoch:
                break
    test = data.splits["test"].part(slice(50))
    truth = test.states
    # measurements may lie further apart than the samples that are scored
    prediction = rollout(model.flow(), truth[:, 0], sampling_interval(test), truth.shape[1])
    error = float(rmse_norm(errors(prediction, truth)[..., : data.source.space.dof]))
    return error if math.isfinite(error) else math.inf


def step(model, objective, batch, optimizer) -> None:
    """Take one step of a stepper; the trainer does the rest of those that leave it to it."""
    loss = model.stepper.step(objective, model.loss, model.dynamics, batch, optimizer)
    if model.stepper.automatic:
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()


def measured(overrides: list[str], seconds: float) -> str:
    """Return the error of a training run as text, `refused` if the measurements do not fit the recipe."""
    try:
        return f"{trained(overrides, seconds):.4g}"
    except UserError:
        return "refused"
    except TrainingError:
        return "inf"


def commanded(overrides: list[str]) -> tuple[str, str]:
    """Return the error and the seconds of a complete command, as text; `refused` as in `measured`."""
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder, "run")
        asked = [*overrides, "plugins=none", "evaluation=scores", f"run={run}"]
        done = subprocess.run([sys.executable, "-m", "ahnn.train", *asked], capture_output=True, text=True)
        if done.returncode in ENDS:
            return ENDS[done.returncode], ""
        if done.returncode:
            raise RuntimeError(done.stderr)
        scores = json.loads((run / "metrics.json").read_text())
    return f"{scores['rows'][0]['position']:.4g}", f"{scores['training']['seconds']:.0f}"


def brought(overrides: list[str]) -> str:
    """Return the recipe that a command line takes where it names none."""
    return compose(config_loader(), "train", overrides).hydra.runtime.choices.recipe


def factor(rows: dict[str, str], default: str) -> float:
    """Return the factor by which the default's error exceeds the smallest error of all recipes."""
    known = {name: float(error) for name, error in rows.items() if error != "refused"}
    return known[default] / min(known.values())


def main() -> None:
    """Measure all rows missing in the file, and print the factors."""
    kind = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=kind)
    parser.add_argument("--seconds", type=float, help="CPU time of each run, instead of complete commands")
    parser.add_argument("--seeds", type=int, nargs="+", default=[7, 201, 719])
    parser.add_argument("--systems", nargs="+", default=list(LEVELS), choices=LEVELS)
    parser.add_argument("--recipes", nargs="+", default=list(RECIPES), choices=RECIPES)
    parser.add_argument("--out", type=Path, help="commands.csv, or recipes_SECONDS.csv, without it")
    args = parser.parse_args()
    args.out = args.out or Path(f"recipes_{args.seconds:g}.csv" if args.seconds else "commands.csv")
    torch.set_num_threads(1)
    if args.seconds:
        trained(["experiment=pendulum_angles"], WARM)
    known = {(*row[:4],): row[4] for row in csv.reader(args.out.open())} if args.out.exists() else {}
    for seed, system in itertools.product(args.seeds, args.systems):
        experiment, levels = LEVELS[system]
        for noise in levels:
            asked = [f"experiment={experiment}", f"data.noise={noise}", f"seed={seed}", f"data.seed={seed}"]
            default, rows = brought(asked), {}
            for recipe in {default: None, **dict.fromkeys(args.recipes)}:
                key = system, noise, recipe, str(seed)
                if key not in known:
                    told = [*asked, f"recipe={recipe}"]
                    row = (measured(told, args.seconds), args.seconds) if args.seconds else commanded(told)
                    known[key] = row[0]
                    with args.out.open("a", newline="") as file:
                        csv.writer(file).writerow([*key, *row])
                rows[recipe] = known[key]
                print(*key, rows[recipe], flush=True)
            times = f"{factor(rows, default):.2f} times the best"
            print(f"{system} {noise} seed {seed}: the default, {default}, is {times}", flush=True)


if __name__ == "__main__":
    main()
