"""Are bands right over many draws? `python -m ahnn.calibrate experiment=spring_noisy draws=20`.

KEY=VALUE           as for ahnn.train; the data must be measurements of a system
draws=20            of constants, starts, noise and weights, each with a training of its own
spread=0.1          standard deviation of the logarithms of the system's constants; 0 keeps them
jobs=1              trainings side by side
output=FOLDER       runs/calibration without it: a run folder and a score for each draw, and calibration.png

What is finished is kept: the same command goes on where it was stopped, and shows all draws.
"""

from __future__ import annotations

import logging

from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing


def calibrate(arguments: list[str]) -> None:
    """Train on the draws that a command line asks for, and test them; raises as `cli.calibrating`."""
    with importing():
        from ahnn.cli import calibrating

    calibrating.calibrate(arguments)


def main() -> None:
    """Entry point of `python -m ahnn.calibrate` and `ahnn-calibrate`."""
    run_command(calibrate, __doc__, logging.INFO)


if __name__ == "__main__":
    main()
