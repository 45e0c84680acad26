"""Determine an orbit from tracking data: `python -m ahnn.orbit FILE.yaml [KEY=VALUE...] [out=DIR]`.

FILE.yaml      stations, start, forces, corrections, noise and estimated parameters, docs/tracking.md
folder=DIR     folder of the files named in it; default: its own folder
out=DIR        residuals, unknowns, learned acceleration (CSV) and the orbit with covariances (OEM)
KEY=VALUE      override of a setting in the file: forces.learned=null, held_out=0.2, noise.range=0.01

The model combines forces with known or estimated coefficients, a learned acceleration, and station biases.
"""

from __future__ import annotations

import logging

from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing


def orbit(arguments: list[str]) -> None:
    """Determine the orbit described on the command line; raises the same errors as `jobs.determining`."""
    with importing():
        from ahnn.cli.orbit_file import read_orbit
        from ahnn.jobs import determining

    determining.determine(read_orbit(arguments))


def main() -> None:
    """Entry point of `python -m ahnn.orbit` and `ahnn-orbit`."""
    run_command(orbit, __doc__, logging.INFO)


if __name__ == "__main__":
    main()
