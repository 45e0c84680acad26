"""Check uncertainty bands over many draws: `python -m ahnn.calibrate experiment=spring_noisy draws=20`.

KEY=VALUE           as for ahnn.train; the data must be measurements of a system
draws=20            number of draws of constants, starts, noise and weights, each with a separate training run
spread=0.1          standard deviation of the logarithms of the system's constants; 0 keeps them
fitted=0.5          fraction of the measurements of an unseen trajectory that its forecast starts from
samples=0           sampled paths of each forecast, for states whose errors do not propagate linearly
jobs=1              number of parallel training runs
output=FOLDER       default runs/calibration: a run folder and a score for each draw, and calibration.png

Finished draws are kept: repeat the command to resume, and to print the complete table.
"""

from __future__ import annotations

import logging

from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing


def calibrate(arguments: list[str]) -> None:
    """Train on the requested draws, and test the runs; raises the same errors as `cli.calibrating`."""
    with importing():
        from ahnn.cli import calibrating

    calibrating.calibrate(arguments)


def main() -> None:
    """Entry point of `python -m ahnn.calibrate` and `ahnn-calibrate`."""
    run_command(calibrate, __doc__, logging.INFO)


if __name__ == "__main__":
    main()
