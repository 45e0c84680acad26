"""Published benchmark tasks, original and own models: `python -m ahnn.benchmark NAME... | all [jobs=2]`.

NAME...             two_bodies, three_bodies, noisy_spring, noisy_pendulum, one_orbit,
                    chain_2, chain_3, chain_5, points_henon_heiles,
                    points_fermi_pasta, points_double_pendulum, map_pendulum,
                    map_double_pendulum, map_three_bodies, or all
models=[A,B]        subset of a task's models; default: all
draws=10            number of random data sets and starts, each with a separate training run
jobs=1              number of parallel training runs
output=FOLDER       default runs/benchmark: a run folder and a score for each training run

Finished runs are kept: repeat the command to resume, and to print the complete table.
"""

from __future__ import annotations

import logging

from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing


def benchmark(arguments: list[str]) -> None:
    """Train and score the models of the tasks named; raises the same errors as `cli.benchmarking`."""
    with importing():
        from ahnn.cli import benchmarking

    benchmarking.benchmark(arguments)


def main() -> None:
    """Entry point of `python -m ahnn.benchmark` and `ahnn-benchmark`."""
    run_command(benchmark, __doc__, logging.INFO)


if __name__ == "__main__":
    main()
