"""Overhead of storage, sweeper and pruner compared with the training runs of a sweep.

    python benchmarks/bench_sweep_overhead.py sweep=quick model=hnn [override ...]

The sweep runs in this process. Its cost is all the time outside the launcher (storage, sampler, progress,
table, plots), plus the hooks of the pruner and of the trial inside the jobs.
"""

from __future__ import annotations

import sys
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

from hydra.core.plugins import Plugins

import ahnn.train
from ahnn_plugins.pfl import PFLCallback
from hydra_plugins.ahnn_sweeper._trial import TrialCallback

SPENT: defaultdict[str, float] = defaultdict(float)


def timed(owner: type, name: str, key: str) -> None:
    """Replace a method by one that adds its time to SPENT."""
    method: Callable[..., Any] = getattr(owner, name)

    def measured(*args: Any, **kwargs: Any) -> Any:
        begin = time.perf_counter()
        try:
            return method(*args, **kwargs)
        finally:
            SPENT[key] += time.perf_counter() - begin

    setattr(owner, name, measured)


def main() -> None:
    """Run the sweep and print the shares."""
    plugins = Plugins.instance().class_name_to_class
    timed(plugins["hydra_plugins.ahnn_sweeper.sweeper.AhnnOptunaSweeper"], "sweep", "sweep")
    timed(plugins["hydra._internal.core_plugins.basic_launcher.BasicLauncher"], "launch", "launcher")
    for name in ("on_fit_start", "on_validation_end", "on_fit_end"):
        timed(PFLCallback, name, "pruner")
    for name in ("on_job_start", "on_job_end"):
        timed(TrialCallback, name, "trial")
    sys.argv[1:1] = ["-m"]
    try:
        ahnn.train.main()
    finally:
        sweeper = SPENT["sweep"] - SPENT["launcher"]
        total = sweeper + SPENT["pruner"] + SPENT["trial"]
        parts = f"sweeper {sweeper:.1f}, trial {SPENT['trial']:.1f}, pruner {SPENT['pruner']:.1f}"
        share = 100 * total / SPENT["sweep"]
        print(f"sweep {SPENT['sweep']:.1f} s, including {total:.1f} s ({share:.2f} %) overhead: {parts}")


if __name__ == "__main__":
    main()
