"""Overview of commands and trained models: `python -m ahnn`."""

from __future__ import annotations

import shlex
import sys

from ahnn import __version__

COMMANDS = f"""ahnn {__version__}: learn Hamiltonian dynamics, and assimilate measurements with them

  python -m ahnn.train       train a model and evaluate it              --help
  python -m ahnn.evaluate    evaluate a finished run again              --help
  python -m ahnn.predict     predict states, with uncertainty bands     --help
  python -m ahnn.plan        choose the measurements worth taking       --help
  python -m ahnn.export      export a trained model to other programs   --help
  python -m ahnn.reproduce   reproduce the tables of the paper          --help
  python -m ahnn.benchmark   compare with published benchmark scores    --help
  python -m ahnn.calibrate   check uncertainty bands over many draws    --help
  python -m ahnn.data check  check data before training                 --help
  python -m ahnn.orbit       determine an orbit from tracking data      --help
  python -m ahnn.assimilate  filter a stream of measurements online     --help
  python -m ahnn.report      summarise runs in one HTML file            --help
  tensorboard --logdir runs  curves, scores and figures of all runs

In Python: ahnn.load(RUN), ahnn.fit(TRAJECTORIES, SPACE); see help(ahnn).
Trained models shipped with the package:
  """


OVERVIEW = ([], ["--help"], ["-h"], ["--version"])
"""Arguments with which the overview is printed."""


def tell() -> None:
    """List commands and trained models; raises UserError for other arguments, as commands are separate."""
    from ahnn.errors import UserError
    from ahnn.pretrained import names

    if (given := sys.argv[1:]) not in OVERVIEW:
        name, rest = given[0], shlex.join(given[1:])
        if f"-m ahnn.{name} " not in COMMANDS:
            message = f"expected no arguments; received {name!r}. `ahnn` alone lists the commands"
            raise UserError(message)
        short = f"ahnn-{name} {rest}".rstrip()
        either = "" if name == "data" else f"`{short}` or "
        command = f"python -m ahnn.{name} {rest}".rstrip()
        message = f"expected a command with a hyphen or a module; received {name!r}. Use {either}`{command}`"
        raise UserError(message)

    sys.stdout.write(COMMANDS + ", ".join(names()) + "\n")


def main() -> None:
    """Entry point of `python -m ahnn` and `ahnn`."""
    from ahnn.cli.guard import guard, leave

    if code := guard(tell):
        leave(code)


if __name__ == "__main__":
    main()
