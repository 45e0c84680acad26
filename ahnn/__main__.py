"""Overview of commands and trained models: `python -m ahnn`."""

from __future__ import annotations

import sys

from ahnn import __version__

COMMANDS = f"""ahnn {__version__}: learn Hamiltonian dynamics, and assimilate measurements with them

  python -m ahnn.train       train a model and evaluate it              --help
  python -m ahnn.evaluate    evaluate a finished run again              --help
  python -m ahnn.predict     states to come, with their bands           --help
  python -m ahnn.plan        the measurements that sharpen a forecast   --help
  python -m ahnn.export      a trained model for other programs         --help
  python -m ahnn.reproduce   the tables of the paper                    --help
  python -m ahnn.benchmark   tasks of the field, published scores beside  --help
  python -m ahnn.calibrate   are bands right over many draws?             --help
  python -m ahnn.data check  look data over before they are learned     --help
  python -m ahnn.orbit       an orbit from what stations measured       --help
  python -m ahnn.assimilate  filter a stream of measurements online     --help
  python -m ahnn.report      runs in one HTML file, with figures        --help
  tensorboard --logdir runs  curves, scores and figures of all runs

In Python: ahnn.load(RUN), ahnn.fit(TRAJECTORIES, SPACE); help(ahnn) says more.
Trained models that come with the package:
  """


def tell() -> None:
    """List commands and trained models."""
    from ahnn.pretrained import names

    sys.stdout.write(COMMANDS + ", ".join(names()) + "\n")


def main() -> None:
    """Entry point of `python -m ahnn` and `ahnn`."""
    from ahnn.cli.guard import guard, leave

    if code := guard(tell):
        leave(code)


if __name__ == "__main__":
    main()
