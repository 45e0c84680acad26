"""Time from the start of a process to its end or its first optimiser step: ahnn, and imports only.

    python benchmarks/bench_startup.py [repeats]

Complete processes with their children, in turn: CPU seconds (user and system) and wall time. The first step
is taken by `python -m ahnn.train` with its defaults, with cached trajectories and compiled parts. Peers take
a step of AdamW on one batch of random numbers: they read no configuration and no data, so that only their
imports, and JAX's compilation, count.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median

from timing import Row, has, left_out, markdown, ratio, shown

HERE = Path(__file__).parent
NEEDS = {"JAX": ("jax", "equinox", "optax")}
IMPORT = "import torch"
FIRST = """
import os, sys
from torch.optim.optimizer import register_optimizer_step_post_hook
register_optimizer_step_post_hook(lambda *_: os._exit(0))
from ahnn.train import main
main()
"""
AUTOGRAD = """
import torch, torch_peer
net = torch_peer.network(24, 2, "tanh", 2)
data = torch.randn(1000, 2), torch.randn(1000, 1, 2)
torch_peer.training_step(net, torch_peer.increment, *data, 0.05, 1)()
"""
JAX = """
import jax_peer, numpy
net = jax_peer.network(24, 2, "tanh", 2, jax_peer.jnp.float32)
data = numpy.ones((1000, 2), "f"), numpy.ones((1000, 1, 2), "f")
jax_peer.training_step(net, *data, 0.05, 1)()
"""


def spent(*words: str) -> tuple[float, float]:
    """Return CPU and wall seconds of a process of Python."""
    paths = [str(HERE), str(HERE.parent), str(HERE.parent / "plugins"), os.environ.get("PYTHONPATH", "")]
    begin = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, *words],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
        stdout=subprocess.DEVNULL,
    )
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    wall = time.perf_counter() - begin
    assert process.returncode == 0, f"{' '.join(words)}: exit status {process.returncode}"
    return usage.ru_utime + usage.ru_stime, wall


def works(folder: str) -> dict[str, dict[str, tuple[str, ...]]]:
    """Return the processes of each row, by who they are of."""
    settings = ["plugins=none", "trainer.accelerator=cpu", f"data.cache={folder}/cache", f"run={folder}/run"]
    step = {"ahnn": ("-c", FIRST, *settings), IMPORT: ("-c", IMPORT), "autograd.grad": ("-c", AUTOGRAD)}
    if has(NEEDS["JAX"]):
        step["JAX"] = ("-c", JAX)
    load = "import ahnn; ahnn.load('molniya_mechanical')"
    return {
        "first step of a training run with the defaults": step,
        "loading a model with `ahnn.load`": {"ahnn": ("-c", load), IMPORT: ("-c", IMPORT)},
        "`ahnn.train --help`": {"ahnn": ("-m", "ahnn.train", "--help"), IMPORT: ("-c", IMPORT)},
    }


def measured(repeats: int) -> Iterator[tuple[Row, list[float]]]:
    """Yield a row of CPU seconds for each start, and wall seconds of ahnn's."""
    with tempfile.TemporaryDirectory() as folder:
        for name, processes in works(folder).items():
            row, walls = Row(name, {who: [] for who in processes}, None), []
            for repeat in range(-1, repeats):
                for who, words in processes.items():
                    used, wall = spent(*words)
                    if repeat >= 0:  # the first fills the caches
                        row.times[who].append(used)
                        walls += [wall] if who == "ahnn" else []
            yield row, walls


def startup(repeats: int) -> str:
    """Return the table."""
    heads, lines = ["one process", "CPU [s]", "wall [s]", f"`{IMPORT}`, CPU [s]"], []
    peers = (IMPORT, "autograd.grad", *NEEDS)
    for (name, times, _), walls in measured(repeats):
        own = times["ahnn"]
        cells = [name, *(shown(median(found)) for found in (own, walls, times[IMPORT]))]
        lines.append([*cells, *(shown(ratio(own, times[who])) if who in times else "" for who in peers)])
    return markdown([*heads, *(f"ahnn / {who}" for who in peers)], lines)


def main() -> None:
    """Print the table."""
    left_out(NEEDS)
    print(startup(int(sys.argv[1]) if len(sys.argv) > 1 else 5))


if __name__ == "__main__":
    main()
