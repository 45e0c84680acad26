"""Training steps and rollouts by ahnn and its peers, in turn; writes docs/benchmarks.md and its picture.

    python benchmarks/run.py [repeats]

Peers come with the extra `bench`; one that is not installed is left out by name.
"""

from __future__ import annotations

import os
import platform
import sys
from pathlib import Path
from statistics import median

import filter_works
import torch
from timing import Row, ratio, settle
from works import missing, rollouts, training

from ahnn.files import write_atomically

DOCS = Path(__file__).parent.parent / "docs"
PEERS = ("autograd.grad", "torchdiffeq", "JAX")
FILTER = """## The filter

Two bodies with J2, a position after every step, float64: microseconds for one step of one member. The
filter's own library is compiled once for a machine; `compiled` is ahnn with the flow through `torch.compile`
besides, as dynamax has it jitted. The floor is the compiled flow alone on all sigma points.
"""
OPENING = """# Benchmarks

`make bench` measures ahnn and its peers on the same work, in turn (A B A B), on one thread, and writes this
page. Times are CPU milliseconds, medians; ratios are medians of the ratios of each repeat, below 1 where
ahnn is faster. The floor is the time that the multiply-adds of the network take as plain matrix products.

- **autograd.grad**: plain PyTorch, the field as `autograd.grad` of the energy with its graph.
- **torchdiffeq**: the same field through `odeint(method="rk4")`, its 3/8 rule.
- **JAX**: Equinox and Optax, a whole step or a whole rollout jitted; compilation is not counted.

All follow a generic Hamiltonian network of three degrees of freedom by Runge-Kutta steps of order four. A
training step is the Huber loss of the recursive predictions over a window, its gradient and AdamW, in
float32, without Lightning; the optimiser of ahnn is fused, as `recipe=first_order` has it, that of the
peers in PyTorch is the default one. Steps of ahnn and their reverse are in C where there is a compiler, as
in any training, and its rollouts, as `run.rollout` has them. Compiled is the same step with `compile=true`,
by torch and its compiler alone, whose time is not counted either. The floor is of torch's own products,
which do not use all that some processors have: it can be undercut.
"""


def cpu() -> str:
    """Return the name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def table(rows: list[Row], what: str) -> str:
    """Return rows as a Markdown table."""
    heads = [f"{what} [ms]", "ahnn", "floor", "ahnn / floor", *(f"ahnn / {peer}" for peer in PEERS)]
    compiled = any("compiled" in row.times for row in rows)
    heads += ["compiled", "compiled / JAX"] if compiled else []
    lines = ["| " + " | ".join(heads) + " |", "|---" + "|--:" * (len(heads) - 1) + "|"]
    for row in rows:
        own, floor = row.times["ahnn"], row.floor
        assert floor is not None
        times = (f"{1e3 * median(own):.4g}", f"{1e3 * median(floor):.3g}")
        cells = [row.name, *times, f"{ratio(own, floor):.1f}"]
        cells += [f"{ratio(own, row.times[peer]):.2f}" if peer in row.times else "" for peer in PEERS]
        if compiled:
            made, jax = row.times["compiled"], row.times.get("JAX")
            cells += [f"{1e3 * median(made):.4g}", f"{ratio(made, jax):.2f}" if jax else ""]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def picture(rows: list[Row], path: Path) -> None:
    """Draw the time of each in units of the floor."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 0.75 * len(rows) + 1.2), layout="constrained")
    names = ("ahnn", *(who for who in ("compiled", *PEERS) if any(who in row.times for row in rows)))
    for k, who in enumerate(names):
        places = [i + 0.18 * k for i, row in enumerate(rows) if who in row.times]
        lengths = [ratio(row.times[who], row.floor or []) for row in rows if who in row.times]
        axes.barh(places, lengths, height=0.16, label=who)
    axes.axvline(1.0, color="black", linewidth=1, linestyle="--", label="floor: matrix products alone")
    axes.set_yticks([i + 0.09 * (len(names) - 1) for i in range(len(rows))], [row.name for row in rows])
    axes.invert_yaxis()
    axes.set_xlabel("CPU time / floor")
    figure.legend(loc="outside lower center", ncols=3)
    figure.savefig(path, dpi=120)


def main() -> None:
    """Measure, and write the page."""
    repeats = int(sys.argv[1]) if len(sys.argv) > 1 else 15
    settle()
    left_out, load = [*missing(), *filter_works.missing()], os.getloadavg()[0]
    for name in left_out:
        print(f"benchmarks: left out {name}, not installed; pip install -e '.[bench]' brings it")
    steps, rolls = [], []
    for kept, found in ((steps, training(repeats)), (rolls, rollouts(max(3, repeats // 2)))):
        for row in found:
            kept.append(row)
            print(row.name, {who: f"{1e3 * median(t):.3g} ms" for who, t in row.times.items()}, flush=True)
    picture([*steps, *rolls], DOCS / "benchmarks.png")
    shared = f"mean load at the start {load:.1f}: others shared it" if load > 0.5 else "idle before"
    machine = f"Machine: {cpu()}, {os.cpu_count()} cores, PyTorch {torch.__version__}; {shared}.\n"
    absent = f"\nLeft out, since not installed: {', '.join(left_out)}.\n" if left_out else ""
    parts = [OPENING, machine + absent, "## Training steps\n", table(steps, "one step")]
    judged = list(filter_works.filters(max(3, repeats // 2)))
    parts += [
        FILTER,
        filter_works.table(judged),
        "## Rollouts\n",
        table(rolls, "1,440 steps"),
        "![Time in units of the floor](benchmarks.png)\n",
    ]
    write_atomically(DOCS / "benchmarks.md", "\n".join(parts).encode())


if __name__ == "__main__":
    main()
