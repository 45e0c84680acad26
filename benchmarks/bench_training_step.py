"""Time of an optimiser step through `ahnn.train`'s parts, divided by a bare PyTorch loop on the same batches.

    python benchmarks/bench_training_step.py [steps] [repeats]

Both train the same model on the same windows with AdamW at batch 256; ratios are medians over repeats. The
first bare loop has the library's optimiser, the fused AdamW of `conf/optimizer/adamw.yaml`; the second has
`torch.optim.AdamW` with its defaults, as most people write it. The networks are the smallest of the paper's
search, three hidden layers of 128.
"""

from __future__ import annotations

import copy
import sys
import tempfile
import time
from statistics import median

import torch
from hydra import compose, initialize_config_dir
from lightning import Callback

from ahnn.cli.before import quiet
from ahnn.cli.build import OmegaConf  # registers the resolvers of conf/
from ahnn.cli.parts import build_data, build_model, build_source, build_trainer
from ahnn.paths import conf_dir

MODELS = ("mlp", "node", "hnn", "ahnn", "hnn_derivative")


class Stopwatch(Callback):
    """Time between the first and the last training batch of a fit."""

    def __init__(self) -> None:
        self.began = self.ended = 0.0

    def on_train_batch_end(self, *arguments) -> None:
        """Note the time."""
        if arguments[-1] == 0:
            self.began = time.perf_counter()
        self.ended = time.perf_counter()


def calibrated(cfg) -> tuple:
    """Return the data and the model of a configuration, ready to train."""
    data = build_data(cfg, build_source(cfg))
    model = build_model(cfg, data)
    model.calibrate(data.statistics())
    model.about["dt"] = data.statistics().dt
    return data, model


def through_library(cfg, steps: int) -> float:
    """Return seconds per step of a fit with the default callbacks and TensorBoard."""
    data, model = calibrated(cfg)
    trainer = build_trainer(cfg)
    watch = Stopwatch()
    trainer.callbacks.append(watch)
    trainer.fit(model, data)
    return (watch.ended - watch.began) / (steps - 1)


def bare(cfg, steps: int, optimizer_class=None) -> float:
    """Return seconds per step of a plain loop over the same batches."""
    data, model = calibrated(cfg)
    model = copy.deepcopy(model)
    optimizer = (optimizer_class or model.optimisation.optimizer)(model.dynamics.parameters())
    begin = 0.0
    for k, batch in enumerate(data.train_dataloader()):
        optimizer.zero_grad()
        model.loss(model.objective.residuals(model.dynamics, batch)).backward()
        optimizer.step()
        begin = begin or time.perf_counter() if k == 0 else begin
    return (time.perf_counter() - begin) / (steps - 1)


def main() -> None:
    """Print one line for each model."""
    steps, repeats = (int(a) for a in (*sys.argv[1:], "300", "5")[:2])
    quiet()
    torch.set_num_threads(1)
    print(f"ms per step, batch 256, {steps} steps, medians of {repeats}; ratios are library / bare loop")
    print(f"{'model':15s} {'library':>8s} {'bare':>8s} {'ratio':>6s} {'plain':>8s} {'ratio':>6s}")
    for name in MODELS:
        times = []
        for _ in range(repeats):
            with (
                tempfile.TemporaryDirectory() as folder,
                initialize_config_dir(str(conf_dir()), version_base="1.3"),
            ):
                overrides = [
                    f"model={name}",
                    "recipe=first_order",
                    "trainer.max_epochs=1",
                    "data.precision=32",
                    "model.network.width=128",
                    "model.network.depth=3",
                    "plugins=none",
                    "data.batch_size=256",
                    f"data.windows_per_epoch={256 * steps}",
                    "data.val_windows=256",
                    f"folder={folder}",
                ]
                cfg = compose("train", overrides)
                OmegaConf.resolve(cfg)
                plain = bare(cfg, steps, torch.optim.AdamW)
                times.append((through_library(cfg, steps), bare(cfg, steps), plain))
        ours, same, default = (median(column) * 1e3 for column in zip(*times, strict=True))
        ratios = [median(row[0] / row[k] for row in times) for k in (1, 2)]
        row = f"{name:15s} {ours:8.3f} {same:8.3f} {ratios[0]:6.2f} {default:8.3f} {ratios[1]:6.2f}"
        print(row, flush=True)


if __name__ == "__main__":
    main()
