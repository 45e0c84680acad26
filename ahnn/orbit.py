"""Determine an orbit from what stations measured: `python -m ahnn.orbit FILE.yaml [KEY=VALUE...] [out=DIR]`.

FILE.yaml      stations, start, forces, corrections, noise and what is estimated, docs/tracking.md
folder=DIR     that holds the files which it names; its own folder without it
out=DIR        residuals, unknowns, learned acceleration (CSV) and the orbit with covariances (OEM)
KEY=VALUE      in place of what the file says: forces.learned=null, held_out=0.2, noise.range=0.01

Known forces with coefficients, known or estimated; a learned acceleration beside them; biases of stations.
"""

from __future__ import annotations

import logging

from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing

USAGE = "usage: python -m ahnn.orbit FILE.yaml [folder=DIR] [out=DIR] [KEY=VALUE]"


def orbit(arguments: list[str]) -> None:
    """Determine the orbit that a command line asks for; raises as `jobs.determining`."""
    with importing():
        from ahnn.cli.orbit_file import read_orbit
        from ahnn.jobs import determining

    determining.determine(read_orbit(arguments, USAGE))


def main() -> None:
    """Entry point of `python -m ahnn.orbit` and `ahnn-orbit`."""
    run_command(orbit, __doc__, logging.INFO)


if __name__ == "__main__":
    main()
