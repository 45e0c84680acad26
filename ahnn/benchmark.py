"""The field's tasks, theirs beside ours: `python -m ahnn.benchmark noisy_spring two_bodies`, or `all`.

NAME...             two_bodies, three_bodies, noisy_spring, noisy_pendulum, one_orbit,
                    chain_2, chain_3, chain_5, points_henon_heiles,
                    points_fermi_pasta, points_double_pendulum, map_pendulum,
                    map_double_pendulum, map_three_bodies, or all
models=[A,B]        some of a task's models; all of them without it
draws=10            of data and starts, each with a training of its own
jobs=1              trainings side by side
output=FOLDER       runs/benchmark without it: a run folder and a score for each training

What is finished is kept: the same command goes on where it was stopped, and shows the table of all.
"""

from __future__ import annotations

import logging

from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing

USAGE = "usage: python -m ahnn.benchmark NAME... | all [draws=10] [jobs=2] [models=[A,B]] [output=FOLDER]"


def benchmark(arguments: list[str]) -> None:
    """Train and score what a command line asks for; raises as `cli.benchmarking`."""
    with importing():
        from ahnn.cli import benchmarking

    benchmarking.benchmark(arguments, USAGE)


def main() -> None:
    """Entry point of `python -m ahnn.benchmark` and `ahnn-benchmark`."""
    run_command(benchmark, __doc__, logging.INFO)


if __name__ == "__main__":
    main()
