"""Evaluate a finished run again: `python -m ahnn.evaluate run=DIR plugins=ukf`.

run=DIR             a run folder; its own config.yaml and weights are used
pretrained=NAME     a model that comes with the package; run=DIR says where its results are kept
ckpt=best           the weights to evaluate: best, last, or a path
name=NAME           of this evaluation, kept in DIR/evaluations/NAME; date and time without it
plugins=NAME        and measurement=NAME: groups of the library
measurement.bias_sd=NUMBER      also bias_memory=: biases of the sensors, simulated and estimated
KEY=VALUE           of system, data, evaluation, measurement and plugins: on other data, say
--trust             build whatever the folder's config.yaml names; only if you know who wrote it
"""

from __future__ import annotations

import logging

from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing

USAGE = "usage: python -m ahnn.evaluate run=DIR | pretrained=NAME [name=NAME] [plugins=.] [key=value]"


def evaluate(arguments: list[str]) -> None:
    """Evaluate the run that a command line names; raises as `cli.evaluation`."""
    with importing():
        from ahnn.cli.evaluation import read_evaluation
        from ahnn.jobs import evaluating

    evaluating.evaluate(read_evaluation(arguments, USAGE))


def main() -> None:
    """Entry point of `python -m ahnn.evaluate` and `ahnn-evaluate`."""
    run_command(evaluate, __doc__, logging.INFO)


if __name__ == "__main__":
    main()
