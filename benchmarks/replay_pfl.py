"""What would each setting of the pruner have saved and lost on the curves of a sweep that pruned nothing?

    python -m ahnn.train -m sweep=quick model=hnn callbacks.pfl.top_k=1000    # records, judges nothing
    python benchmarks/replay_pfl.py runs/sweeps/quick_mass_spring_hnn

The trials are taken in their order; the sampler's answer to pruning is not part of it.
"""

from __future__ import annotations

import itertools
import json
import sys
from pathlib import Path

from ahnn_plugins.pfl import Settings, decide


def curves(sweep: Path) -> list[list[float]]:
    """Return the validation losses of every trial, one series each, in the order of the trials."""
    logs = sorted(sweep.glob("*/pfl.jsonl"), key=lambda path: int(path.parent.name))
    rows = [[json.loads(line) for line in log.read_text().splitlines()] for log in logs]
    return [[float(row["loss"]) for row in log if "loss" in row] for log in rows]


def replay(trials: list[list[float]], settings: Settings) -> tuple[float, int, int, float]:
    """Return the share of epochs saved, trials pruned, good ones among them, and the loss of the best.

    A good trial would have ended below the threshold it was judged by. The loss is relative to the best.
    """
    finals: list[float] = []
    saved = pruned = good = 0
    for losses in trials:
        for epoch in range(1, len(losses) + 1):
            decision = decide([losses[:epoch]], finals, settings)
            if decision.prune:
                saved, pruned = saved + len(losses) - epoch, pruned + 1
                good += decision.threshold is not None and losses[-1] <= decision.threshold
                break
        else:
            finals.append(losses[-1])
    best = min(losses[-1] for losses in trials)
    return saved / sum(map(len, trials)), pruned, good, min(finals) / best - 1


def main() -> None:
    """Print one line for each setting."""
    trials = curves(Path(sys.argv[1]))
    epochs = max(map(len, trials))
    print(f"{len(trials)} trials; fit, use, fit_epochs, top_k: epochs saved, pruned, good, loss of the best")
    fits, uses = ("log_linear", "power_law", "shifted"), ("first", "all")
    for fit, use, count, top_k in itertools.product(fits, uses, (5, 7, 10), (5, 10)):
        saved, pruned, good, lost = replay(trials, Settings(fit, use, count, epochs, top_k))
        print(f"{fit:10} {use:5} {count:2} {top_k:2}: {saved:6.1%} {pruned:3} {good:3} {lost:6.1%}")


if __name__ == "__main__":
    main()
