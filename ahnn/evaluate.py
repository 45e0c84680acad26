"""Evaluate a finished run again: `python -m ahnn.evaluate run=DIR | pretrained=NAME [plugins=ukf]`.

run=DIR             a run folder; its own config.yaml and weights are used
pretrained=NAME     a model shipped with the package; run=DIR is then the folder of its results
ckpt=best           the weights to evaluate: best, last, or a path
name=NAME           name of this evaluation, stored in DIR/evaluations/NAME; default: date and time
plugins=NAME        also measurement=NAME: options of the library's groups
measurement.bias_sd=NUMBER      also bias_memory=: biases of the sensors, simulated and estimated
KEY=VALUE           settings of system, data, evaluation, measurement and plugins
--trust             build any class named in the folder's config.yaml; only for files you trust
"""

from __future__ import annotations

import logging

from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing


def evaluate(arguments: list[str]) -> None:
    """Evaluate the run named on the command line; raises the same errors as `cli.evaluation`."""
    with importing():
        from ahnn.cli.evaluation import read_evaluation
        from ahnn.jobs import evaluating

    evaluating.evaluate(read_evaluation(arguments))


def main() -> None:
    """Entry point of `python -m ahnn.evaluate` and `ahnn-evaluate`."""
    run_command(evaluate, __doc__, logging.INFO)


if __name__ == "__main__":
    main()
