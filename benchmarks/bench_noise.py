"""Does the recursive loss pay under noise? Every objective on the same noisy states, for the same CPU time.

    python benchmarks/bench_noise.py --out noise.csv

Rows are appended as they are measured; rows in the file are not measured again. Tables of the medians over
seeds, with their range, follow. The error is the mean over unseen trajectories of the rms vector norm, in
rollouts from the true start.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import statistics
from pathlib import Path

import torch
from bench_default_recipe import trained

SYSTEMS = {
    "spring": (["system=mass_spring", "network=tanh_16"], ["0.001", "0.01", "0.1"]),
    "orbit": (
        ["system=molniya", "hamiltonian=mechanical", "inputs=isotropic", "network=tanh_16"],
        ["[0.01,1e-5]", "[0.1,1e-4]", "[1.0,1e-3]"],
    ),
}
STAGES = {
    "spring": "[[16,0.3],[64,0.6],[200,0.9],[whole,1.0]]",
    "orbit": "[[8,0.3],[32,0.6],[128,1.0]]",
}
WINDOWS = (1, 3, 5, 10, 20, 50)


def methods(system: str) -> dict[str, list[str]]:
    """Return the overrides of each objective."""
    noisy = [f"loss.stages={STAGES[system]}", "data.batch_size=100"]
    rows = {f"recursive W={w}": ["recipe=second_order", "loss=recursive", f"window={w}"] for w in WINDOWS}
    return {
        "derivative": ["recipe=second_order", "loss=derivative"],
        **rows,
        "weak": ["recipe=noisy_states", "loss.stages=[[weak,1.0]]", "data.batch_size=20"],
        "relative": ["recipe=noisy_states", "loss.stages=[[relative,1.0]]", "data.batch_size=10"],
        "shooting": ["recipe=measurements", *noisy],
    }


def main() -> None:
    """Measure what the file does not have."""
    kind = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=kind)
    parser.add_argument("--seconds", type=float, default=20, help="CPU time of each training")
    parser.add_argument("--seeds", type=int, nargs="+", default=[7, 201, 719])
    parser.add_argument("--systems", nargs="+", default=list(SYSTEMS), choices=SYSTEMS)
    parser.add_argument("--out", type=Path, default=Path("noise.csv"))
    args = parser.parse_args()
    torch.set_num_threads(1)
    known = {tuple(row[:4]) for row in csv.reader(args.out.open())} if args.out.exists() else set()
    for seed, system in itertools.product(args.seeds, args.systems):
        common, levels = SYSTEMS[system]
        for noise, (name, overrides) in itertools.product(levels, methods(system).items()):
            if (system, noise, name, str(seed)) in known:
                continue
            asked = ["model=ahnn", *common, "sensor=spring_states", f"data.noise={noise}", f"seed={seed}"]
            error = trained([*asked, *overrides], args.seconds)
            with args.out.open("a", newline="") as file:
                csv.writer(file).writerow([system, noise, name, seed, f"{error:.4g}"])
            print(system, noise, name, seed, f"{error:.3g}", flush=True)
    print(tables(args.out))


def short(error: float) -> str:
    """Return two digits of a number, without an exponent where it is large."""
    return f"{float(f'{error:.2g}'):,.0f}" if 100 <= error < 1e9 else f"{error:.2g}"


def tables(path: Path) -> str:
    """Return the medians and ranges of all seeds in Markdown, a table of each system."""
    found: dict[tuple[str, str, str], list[float]] = {}
    for system, noise, name, _, error in csv.reader(path.open()):
        found.setdefault((system, name, noise), []).append(float(error))
    lines = []
    for system, (_, levels) in SYSTEMS.items():
        lines += ["", f"| {system} | {' | '.join(levels)} |", "|---|" + "---|" * len(levels)]
        for name in methods(system):
            cells = [found.get((system, name, noise), []) for noise in levels]
            shown = [
                f"{short(statistics.median(c))} ({short(min(c))} to {short(max(c))})" if c else ""
                for c in cells
            ]
            lines.append(f"| {name} | {' | '.join(shown)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
