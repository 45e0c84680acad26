"""Time of a first-order training step on a GPU, compared with peers.

    python benchmarks/bench_gpu.py --repeats 5

Steps of generic Hamiltonians of three degrees of freedom through rk4 in float32 (no TF32), by the clock: the
loss, its gradient and AdamW. `recorded` is the default of training runs, `eager` is `cuda_graphs=false`.
Peers: plain PyTorch (`autograd.grad` with its graph) and JAX (jitted, products in float32), where it is
installed. Recordings and compilations are not counted.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from statistics import median

os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")

import torch
import torch_peer
from timing import Work, has, in_turn, markdown, ratio, shown
from works import DT, NEEDS, SIZE, own_step

from ahnn.training import FirstOrder
from ahnn.training.cuda_graph import RecordedStep
from ahnn.types import Window

SHAPES = ((64, 2, 1, 256), (64, 2, 5, 256), (256, 4, 5, 256), (256, 4, 5, 8192))
"""Width, hidden layers, window and batch."""
SECONDS = 0.2
"""Of steps in one repeat, about."""


def waited(work: Work) -> Work:
    """Return work that ends when the device has done it."""

    def whole() -> None:
        work()
        torch.cuda.synchronize()

    return whole


def row(width: int, depth: int, window: int, size: int, repeats: int) -> list[str]:
    """Measure one size and return its row of the table."""
    rng = torch.Generator().manual_seed(1)
    start = torch.randn(size, SIZE, generator=rng)
    targets = 0.01 * torch.randn(size, window, SIZE, generator=rng)
    batch = Window(start.cuda(), targets.cuda(), DT)
    steppers = {"recorded": RecordedStep(size), "eager": FirstOrder()}
    own = width, depth, "gelu", batch
    once = waited(own_step(*own, 1, steppers["recorded"]))
    once()
    began = time.perf_counter()
    once()
    steps = max(3, min(100, int(SECONDS / (time.perf_counter() - began))))
    works = {name: waited(own_step(*own, steps, stepper)) for name, stepper in steppers.items()}
    net = torch_peer.network(width, depth, "gelu", SIZE).cuda()
    plain = torch_peer.training_step(net, torch_peer.increment, batch.start, batch.increments, DT, steps)
    works["autograd.grad"] = waited(plain)
    if has(NEEDS["JAX"]):
        import jax_peer

        jax_peer.jax.config.update("jax_default_matmul_precision", "highest")
        net = jax_peer.network(width, depth, "gelu", SIZE, jax_peer.jnp.float32)
        works["JAX"] = jax_peer.training_step(net, start.numpy(), targets.numpy(), DT, steps)
    times = in_turn("", works, repeats, clock=time.perf_counter).times
    cells = [f"{depth}x{width}, window {window}, batch {size:,}"]
    cells += [shown(1e3 * median(times[name]) / steps) if name in times else "" for name in COLUMNS]
    cells += [shown(ratio(times["recorded"], times[peer])) if peer in times else "" for peer in PEERS]
    print(cells, flush=True)
    return cells


PEERS = ("autograd.grad", "JAX")
COLUMNS = ("recorded", "eager", *PEERS)


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
    if not torch.cuda.is_available():
        sys.exit("bench_gpu: no GPU, or a PyTorch without CUDA")
    heads = ["one step [ms]", *COLUMNS, *(f"recorded / {peer}" for peer in PEERS)]
    rows = [row(*shape, repeats) for shape in SHAPES]
    print(f"{torch.cuda.get_device_name()}, PyTorch {torch.__version__}, {repeats} repeats\n")
    print(markdown(heads, rows))


if __name__ == "__main__":
    main()
