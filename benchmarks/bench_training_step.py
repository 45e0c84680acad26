"""Time of an optimiser step through `ahnn.train`'s parts, divided by a bare PyTorch loop on the same batches.

    python benchmarks/bench_training_step.py [steps] [repeats]

Both train the same model on the same windows with AdamW at batch 256, in CPU time; ratios are medians over
repeats. The first bare loop has the library's optimiser, the fused AdamW of `conf/optimizer/adamw.yaml`; the
second has `torch.optim.AdamW` with its defaults, as most people write it. `barebones` is Lightning's own
trainer of that name, without callbacks, a logger or checkpoints: the cost of its loop. The networks are
the smallest of the paper's search, three hidden layers of 128.
"""

from __future__ import annotations

import copy
import sys
import tempfile
import time
from collections.abc import Iterator

import torch
from hydra import compose, initialize_config_dir
from lightning import Callback, Trainer
from omegaconf import DictConfig
from timing import Row, settle, table

from ahnn.cli.build import OmegaConf  # registers the resolvers of conf/
from ahnn.cli.preflight import quiet
from ahnn.cli.prepare import prepare
from ahnn.paths import conf_dir

MODELS = ("mlp", "node", "hnn", "ahnn", "hnn_derivative")


class Stopwatch(Callback):
    """CPU time between the first and the last training batch of a fit."""

    def __init__(self) -> None:
        self.began = self.ended = 0.0

    def on_train_batch_end(self, *arguments) -> None:
        """Note the time."""
        if arguments[-1] == 0:
            self.began = time.process_time()
        self.ended = time.process_time()


def calibrated(cfg) -> tuple:
    """Return the data and the model of a configuration, ready to train."""
    prepared = prepare(cfg)
    data, model = prepared.data, prepared.model
    model.calibrate(data.statistics())
    model.learns_from(dt=data.statistics().dt)
    return data, model


def through_library(cfg, steps: int) -> float:
    """Return CPU seconds per step of a fit with the default callbacks and TensorBoard."""
    return _fit(cfg, prepare(cfg).trainer, steps)


def through_lightning(cfg, steps: int) -> float:
    """Return CPU seconds per step of a fit with nothing but Lightning's loop."""
    return _fit(cfg, Trainer(max_epochs=1, accelerator="cpu", barebones=True), steps)


def _fit(cfg, trainer: Trainer, steps: int) -> float:
    data, model = calibrated(cfg)
    watch = Stopwatch()
    trainer.callbacks.append(watch)
    trainer.fit(model, data)
    return (watch.ended - watch.began) / (steps - 1)


def bare(cfg, steps: int, optimizer_class=None) -> float:
    """Return CPU seconds per step of a plain loop over the same batches."""
    data, model = calibrated(cfg)
    model = copy.deepcopy(model)
    optimizer = (optimizer_class or model.optimisation.optimizer)(model.dynamics.parameters())
    begin = 0.0
    for k, batch in enumerate(data.train_dataloader()):
        optimizer.zero_grad()
        model.loss(model.objective.residuals(model.dynamics, batch)).backward()
        optimizer.step()
        begin = begin or time.process_time() if k == 0 else begin
    return (time.process_time() - begin) / (steps - 1)


def configuration(overrides: list[str]) -> DictConfig:
    """Return a configuration of one epoch of the recipe of first-order steps, in batches of 256."""
    common = ["recipe=first_order", "trainer.max_epochs=1", "trainer.accelerator=cpu", "data.precision=32"]
    common += ["plugins=none", "data.batch_size=256", "data.val_windows=256"]
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        cfg = compose("train", [*common, *overrides])
    OmegaConf.resolve(cfg)
    return cfg


def measured(steps: int, repeats: int) -> Iterator[Row]:
    """Yield a row for each model, seconds of a step."""
    for name in MODELS:
        row = Row(name, {who: [] for who in ("ahnn", "barebones", "bare loop", "plain AdamW")}, None)
        for _ in range(repeats):
            with tempfile.TemporaryDirectory() as folder:
                overrides = [f"model={name}", "model.network.width=128", "model.network.depth=3"]
                overrides += [f"data.windows_per_epoch={256 * steps}", f"folder={folder}"]
                cfg = configuration(overrides)
                row.times["plain AdamW"].append(bare(cfg, steps, torch.optim.AdamW))
                row.times["ahnn"].append(through_library(cfg, steps))
                row.times["barebones"].append(through_lightning(cfg, steps))
                row.times["bare loop"].append(bare(cfg, steps))
        yield row


def main() -> None:
    """Print the table."""
    steps, repeats = (int(a) for a in (*sys.argv[1:], "300", "5")[:2])
    quiet()
    settle()
    print(table([*measured(steps, repeats)], "one step [ms]"))


if __name__ == "__main__":
    main()
