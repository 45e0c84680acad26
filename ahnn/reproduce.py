"""Reproduce the paper's tables: `python -m ahnn.reproduce system=mass_spring budget=laptop`.

MLP, NODE, HNN, AHNN3 and AHNN5 with the seeds 7, 201 and 719, each with and without the unscented Kalman
filter, from the true and from a perturbed start: 15 training runs with equal numbers of steps, each in its
own folder, and a table. Repeat the command to resume after an interruption.

system=mass_spring        Table 1; system=molniya is Table 2
budget=smoke              does it run?  laptop: two cores; paper: a GPU
run=DIR                   folder of the runs; default runs/reproduce/SYSTEM_BUDGET
experiment=paper_hnn,...  subset of paper_mlp, paper_node, paper_hnn, paper_ahnn3, paper_ahnn5
seed=7                    subset of the seeds
GROUP=OPTION KEY=VALUE    as for python -m ahnn.train, for all models: scaling=minmax, loss=recursive_state
hydra/launcher=joblib hydra.launcher.n_jobs=2     parallel runs
"""

from __future__ import annotations

import logging

from ahnn.cli import reproducing
from ahnn.cli.guard import run_command


def reproduce(arguments: list[str]) -> None:
    """Reproduce the table named on the command line; raises the same errors as `cli.reproducing`."""
    reproducing.reproduce(arguments)


def main() -> None:
    """Entry point of `python -m ahnn.reproduce` and `ahnn-reproduce`."""
    run_command(reproduce, __doc__, logging.INFO)


if __name__ == "__main__":
    main()
