"""How costs grow: a training step with batch, width and window; data and memory with trajectories.

    python benchmarks/bench_scaling.py [picture.png]

Steps as in `works.py`: first order, float32, one thread, 2 x 64 GELU units, window 1 and batch 256 unless
stated; CPU seconds, medians of alternating measurements. Data: complete runs of `python -m ahnn.train` on the
spring with 1,001 samples per trajectory and two epochs of 50 steps, in separate processes with a separate
cache; wall time, and the largest memory of a process.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

import torch
from timing import in_turn, settle
from works import DT, SIZE, own_step

from ahnn.types import Window

BATCHES = (64, 256, 1024, 4096, 16384)
WIDTHS = (16, 32, 64, 128, 256, 512)
WINDOWS = (1, 2, 4, 8, 16, 32)
TRAJECTORIES = (250, 1000, 4000, 16000)
RUN = ["recipe=first_order", "plugins=none", "trainer.max_epochs=2", "data.windows_per_epoch=12800"]
Curve = dict[float, float]


def step_seconds(width: int = 64, window: int = 1, batch: int = 256, repeats: int = 7) -> float:
    """Return CPU seconds of an optimiser step."""
    generator = torch.Generator().manual_seed(1)
    start = torch.randn(batch, SIZE, generator=generator)
    targets = 0.01 * torch.randn(batch, window, SIZE, generator=generator)
    steps = max(1, 2560 * 64 // (batch * window * width))
    work = own_step(width, 2, "gelu", Window(start, targets, DT), steps)
    return median(in_turn("", {"ahnn": work}, repeats).times["ahnn"]) / steps


def run_costs(trajectories: int) -> tuple[float, float, float]:
    """Return seconds of a first run and of one with its data in the cache, and their peak memory [GB]."""
    seconds = []
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"AHNN_CACHE": folder}
        for name in ("first", "again"):
            asked = [*RUN, f"data.trajectories={trajectories}", f"run={folder}/{name}"]
            begin = time.perf_counter()
            command = [sys.executable, "-m", "ahnn.train", *asked]
            subprocess.run(command, check=True, capture_output=True, env=environment)
            seconds.append(time.perf_counter() - begin)
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6  # of the largest run so far
    return seconds[0], seconds[1], peak


def curves() -> dict[str, dict[str, Curve]]:
    """Return for each picture its curves."""
    steps = {
        "batch": {n: step_seconds(batch=n) for n in BATCHES},
        "width": {n: step_seconds(width=n) for n in WIDTHS},
        "window": {n: step_seconds(window=n) for n in WINDOWS},
    }
    costs = {n: run_costs(n) for n in TRAJECTORIES}
    found = {name: {"step [ms]": {n: 1e3 * t for n, t in curve.items()}} for name, curve in steps.items()}
    names = ("first run [s]", "data in the cache [s]", "peak memory [GB]")
    found["trajectories"] = {name: {n: row[k] for n, row in costs.items()} for k, name in enumerate(names)}
    return found


def picture(found: dict[str, dict[str, Curve]], path: Path) -> None:
    """Draw them, with a line of slope one through the last point of each picture's first curve."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(2, 2, figsize=(8, 6), layout="constrained")
    for axes, (what, rows) in zip(panels.flat, found.items(), strict=True):
        for marker, (name, curve) in zip("osv", rows.items(), strict=False):
            axes.loglog(list(curve), list(curve.values()), marker=marker, label=name)
        curve = next(iter(rows.values()))
        last, low = list(curve.items())[-1], min(curve)
        axes.loglog(
            [low, last[0]], [last[1] * low / last[0], last[1]], "k:", linewidth=1, label="in proportion"
        )
        axes.set_xticks(list(curve), [f"{n:,}" for n in curve], minor=False)
        axes.set_xticks([], minor=True)
        axes.set_xlabel(what)
        axes.set_ylim(bottom=min(v for c in rows.values() for v in c.values()) / 2)
        axes.legend(fontsize="small")
        axes.grid(visible=True, alpha=0.3)
    figure.savefig(path, dpi=120)


def main() -> None:
    """Print the table, and draw it where a file is named."""
    settle()
    found = curves()
    for what, rows in found.items():
        points = list(next(iter(rows.values())))
        print(f"| {what} | " + " | ".join(f"{n:,}" for n in points) + " |")
        print("|---" + "|--:" * len(points) + "|")
        for name, curve in rows.items():
            print(f"| {name} | " + " | ".join(f"{value:.3g}" for value in curve.values()) + " |")
        print(flush=True)
    if len(sys.argv) > 1:
        picture(found, Path(sys.argv[1]))


if __name__ == "__main__":
    main()
