"""Command lines: wrong keys, options and values; each is checked and composed, not trained."""

from __future__ import annotations

from functools import partial

from ahnn.cli import commandline
from ahnn.cli.compose import compose_job
from ahnn.cli.prepare import prepare
from ahnn.cli.settings import check_settings

KEYS = [
    "seed",
    "threads",
    "window",
    "label",
    "ckpt",
    "weights",
    "data.batch_size",
    "data.trajectories",
    "data.split",
    "data.seed",
    "data.emphasis",
    "data.precision",
    "data.windows_per_epoch",
    "model.network.width",
    "model.network.depth",
    "model.network.activation",
    "model.hamiltonian",
    "model.inputs",
    "model.scaling",
    "model.mu",
    "loss.delta",
    "loss.derivative",
    "loss.order",
    "loss.scale",
    "loss.balance",
    "system.dt",
    "system.steps",
    "system.mass",
    "system.name",
    "optimizer.damping",
    "integrator.name",
    "trainer.max_epochs",
    "trainer.devices",
    "trainer.accelerator",
    "evaluation.seed",
    "plugins.ukf.cadence",
    "plugins.ukf.alpha",
    "plugins.ukf.gate",
    "plugins.ukf.form",
    "plugins.ukf.process_noise",
    "measurement.sd",
    "nonsense",
    "data.nonsense",
    "system.nonsense",
]
VALUES = [
    "0",
    "-1",
    "1",
    "2",
    "7",
    "1e9",
    "1e30",
    "1e400",
    "-0.5",
    "0.3",
    "nan",
    "inf",
    "-inf",
    "null",
    "true",
    "false",
    "x",
    "[]",
    "[1]",
    "[1,2]",
    "[0.8,0.1,0.1]",
    "{a:1}",
    "''",
    "99999999999999999999",
    "1_000",
    "0x10",
    "rk4",
    "tanh",
    "generic",
    "block",
    "minmax",
    '"a=b"',
    "ü",
    "2.5",
    "1e-300",
]
GROUPS = {
    "model": ["mlp", "node", "hnn", "ahnn", "hnn_derivative", "anhn", "null"],
    "system": ["mass_spring", "molniya", "kepler", "pendulum", "henon_heiles", "molnya", "3"],
    "recipe": ["second_order", "eccentric", "first_order", "paper", "x"],
    "budget": ["smoke", "laptop", "paper", "tiny"],
    "integrator": ["rk4", "leapfrog", "gl4", "dopri8", "kahan_li8", "rk5"],
    "hamiltonian": ["generic", "separable", "mechanical", "central_body"],
    "experiment": ["molniya_mechanical", "spring", "null", "sprng"],
    "plugins": ["ukf", "none", "ukf_tuned", "[ukf]"],
    "measurement": ["position", "state", "ground_station", "gnss_range"],
    "optimizer": ["adamw", "levenberg_marquardt", "null"],
}


def cases(draw, folder):
    """Yield command lines of one to four words."""
    while True:
        words = [word(draw) for _ in range(draw.randint(1, 4))]
        yield " ".join(words), partial(attempt, words, folder)


def word(draw) -> str:
    """Return a word of a command line, right or wrong."""
    if draw.random() < 0.35:
        group = draw.choice(list(GROUPS))
        return f"{group}={draw.choice(GROUPS[group])}"
    text = f"{draw.choice(KEYS)}={draw.choice(VALUES)}"
    if draw.random() < 0.15:
        text = draw.choice(["+", "++", "~"]) + text
    if draw.random() < 0.08:
        place = draw.randrange(len(text))
        text = text[:place] + draw.choice("=[]{}\"'$,:~ \\") + text[place:]
    return text


def attempt(words, folder) -> None:
    """Do everything that a training does before it writes or generates anything."""
    plain = [text for text in words if text not in ("experiment=null",)]
    commandline.check(commandline.read(plain), "train")
    defaults = [] if any(text.startswith("plugins") for text in plain) else ["plugins=ukf"]
    cfg = compose_job([*defaults, *plain], folder)
    check_settings(cfg)
    prepare(cfg, asked=())
