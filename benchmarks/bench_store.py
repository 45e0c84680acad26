"""Time of training steps on a mapped data set, relative to the same steps on data in memory.

    python benchmarks/bench_store.py FOLDER [trajectories] [samples] [steps] [recipe]

A spring's trajectories are written into FOLDER, part by part, in closed form: its integrator would take
most of an hour for a million. Two processes take turns: one maps them, and measures first `mapped` and then
`cold`, after their pages were dropped from the system's cache; the other, `memory`, holds a quarter of them,
so that it fits. Steps are taken by Lightning's loop with a recipe's optimiser on randomly drawn windows; wall
time, since a disk uses no CPU time.
"""

from __future__ import annotations

import ctypes
import json
import mmap
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median

import torch
from hydra import compose, initialize_config_dir
from lightning import Callback
from omegaconf import DictConfig

from ahnn.cli.build import OmegaConf  # registers the resolvers of conf/
from ahnn.cli.parts import build_source
from ahnn.cli.preflight import quiet
from ahnn.cli.prepare import prepare
from ahnn.data import store
from ahnn.data.datamodule import WindowDataModule
from ahnn.paths import conf_dir
from ahnn.statistics import Statistics
from ahnn.systems import System
from ahnn.types import Trajectories, rows_of_part

REPEATS = int(os.environ.get("REPEATS", "3"))
SMALLER = 4
"""Factor by which the data in memory are fewer."""


class Stopwatch(Callback):
    """Times at the ends of the training batches of a fit."""

    def __init__(self) -> None:
        self.times: list[tuple[float, float]] = []

    def on_train_batch_end(self, *_) -> None:
        """Note wall and CPU time."""
        self.times.append((time.perf_counter(), time.process_time()))


def turned(system: System, count: int) -> Iterator[Trajectories]:
    """Yield the parts of `count` trajectories of a spring, in closed form."""
    x = system.initial_states(count, torch.Generator().manual_seed(0))
    parameters = system.parameters()
    mass, frequency = parameters["mass"], (parameters["stiffness"] / parameters["mass"]) ** 0.5
    times = torch.arange(system.steps + 1, dtype=torch.float64) * system.dt
    cos, sin = (frequency * times).cos(), (frequency * times).sin()
    for q, p in (part.unsqueeze(-1).unbind(1) for part in x.split(rows_of_part(len(times), 2))):
        speed = p / (mass * frequency)
        states = torch.stack((q * cos + speed * sin, mass * frequency * (speed * cos - q * sin)), dim=-1)
        yield Trajectories(states, times.expand(len(states), -1))


def configuration(folder: Path, count: int, samples: int, steps: int, recipe: str, run: str) -> DictConfig:
    """Return the configuration of one epoch of so many steps."""
    overrides = [
        f"recipe={recipe}",
        "plugins=none",
        "logger=none",
        "trainer.max_epochs=1",
        "trainer.accelerator=cpu",
        f"system.steps={samples - 1}",
        f"data.trajectories={count}",
        f"data.cache={folder}",
        "data.val_windows=256",
        f"folder={run}",
        f"run={run}",
    ]
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        cfg = compose("train", overrides)
        cfg.data.windows_per_epoch = cfg.data.batch_size * steps
        OmegaConf.resolve(cfg)
        return cfg


def written(cfg, count: int) -> Path:
    """Return the store of a configuration, written where it is missing."""
    source = build_source(cfg)
    path = store.place(source.cache, source.recipe())
    if not path.exists():
        begin = time.perf_counter()
        store.write(path, turned(source.truth, count), source.recipe())
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        print(f"written in {time.perf_counter() - begin:.0f} s, {peak:.2f} GiB of memory at most", flush=True)
    return path


def drop(path: Path, states: torch.Tensor) -> None:
    """Take the pages of a mapped file from this process and from the system's cache."""
    size, page = path.stat().st_size, mmap.PAGESIZE
    begin = ctypes.c_void_p(states.data_ptr() // page * page)
    assert ctypes.CDLL(None).madvise(begin, ctypes.c_size_t(size), mmap.MADV_DONTNEED) == 0
    with path.open("rb") as file:
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def fitted(cfg: DictConfig, data: WindowDataModule, statistics: Statistics) -> dict[str, float]:
    """Return milliseconds of a step: median and mean of the wall clock, median of the processor's."""
    prepared = prepare(cfg)
    model, trainer, watch = prepared.model, prepared.trainer, Stopwatch()
    model.calibrate(statistics)
    model.learns_from(dt=statistics.dt)
    trainer.callbacks.append(watch)
    faults = resource.getrusage(resource.RUSAGE_SELF).ru_majflt
    trainer.fit(model, data)
    faults = resource.getrusage(resource.RUSAGE_SELF).ru_majflt - faults
    first, *_, last = watch.times
    pairs = [*zip(watch.times, watch.times[1:], strict=False)]
    wall, cpu = (median(b[k] - a[k] for a, b in pairs) * 1e3 for k in (0, 1))
    mean = (last[0] - first[0]) / len(pairs) * 1e3
    return {"wall": wall, "mean": mean, "cpu": cpu, "pages read": faults}


def measured(mode: str, cfg: DictConfig, path: Path) -> dict[str, dict[str, float]]:
    """Return the time of a fit, on mapped data also without cached pages, and the seconds before it.

    The statistics are taken from one part, which saves a pass over all data.
    """
    begin = time.perf_counter()
    data = prepare(cfg).data
    if mode == "memory":
        whole = data.source.read()
        held = whole._replace(states=whole.states.clone())
        data.source.read = lambda: held
        del whole
    statistics = Statistics.of(next(data.trajectories("train").parts()))
    windows = data.train_dataloader().windows
    ready = {"seconds": time.perf_counter() - begin}
    found = {mode: fitted(cfg, data, statistics)}
    if mode == "mapped":
        drop(path, windows.flat)
        data.val_dataloader = lambda: []
        found["cold"] = fitted(cfg, data, statistics)
    return {
        **found,
        "ready": ready,
        "peak": {"GiB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20},
    }


def main() -> None:
    """Write the stores where they are missing, and print a line for each way and the ratios."""
    folder = Path(sys.argv[1]).absolute()
    count, samples, steps = (int(a) for a in (*sys.argv[2:5], "1000000", "821", "200")[:3])
    recipe, mode = (*sys.argv[5:7], "first_order", "")[:2] if len(sys.argv) != 6 else (sys.argv[5], "")
    quiet()
    torch.set_num_threads(1)
    if mode:
        with tempfile.TemporaryDirectory() as run:
            cfg = configuration(folder, count, samples, steps, recipe, run)
            print(json.dumps(measured(mode, cfg, written(cfg, count))))
        return
    for many in (count, count // SMALLER):
        size = written(configuration(folder, many, samples, steps, recipe, "."), many).stat().st_size
        print(f"{size / 1e9:.1f} GB", flush=True)
    found: dict[str, list[float]] = {}
    for _ in range(REPEATS):
        for name, many in (("mapped", count), ("memory", count // SMALLER)):
            words = (folder, many, samples, steps, recipe, name)
            command = [sys.executable, __file__, *map(str, words)]
            said = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
            for way, row in json.loads(said.splitlines()[-1]).items():
                found.setdefault(way, []).append(row.get("mean", 0.0))
                print(f"{way:8s}", *(f"{key} {value:8.2f}" for key, value in row.items()), flush=True)
    for way in ("mapped", "cold"):
        print(f"{way} / memory: {median(found[way]) / median(found['memory']):.2f}")


if __name__ == "__main__":
    main()
