"""Plan measurements: `python -m ahnn.plan run=DIR start=FILE stations=FILE duration=1d every=1min choose=4`.

Chooses the sessions of ground stations, or the position fixes, that make the forecast of the position most
precise, given the uncertainty of the start and of the learned dynamics. It needs no measurements.

run=DIR             a run folder
pretrained=NAME     a model shipped with the package
ckpt=best           the weights: best, last, or a path
start=FILE          state from which measurements can be taken, or numbers in the model's units
start_sd=[..]       its standard deviations: [position,velocity], or one for each component
duration=1d         time in which measurements can be taken, after the start
every=1min          interval between measurements
at=3d               time of the forecast after the start; default: the end of the duration
choose=4            number of sessions
session=30min       longest session of a station; default: a full pass
stations=FILE       ground stations with noise, biases and masks (docs/assimilate.md)
position_sd=0.02    instead, the standard deviation of position fixes; each is a session
output=FILE.csv     the plan in order of choice; default: only a summary
epoch=2024-03-01T12:00:00       epoch of time zero, unless the start has dates
frame=[EME2000,EARTH,UTC]       frame, centre and time system, unless defined by model or file
"""

from __future__ import annotations

import logging

from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing


def plan(arguments: list[str]) -> None:
    """Plan as requested on the command line; raises the same errors as `jobs.planning`."""
    with importing():
        from ahnn.cli.pairs import read_pairs
        from ahnn.jobs import planning

    planning.plan(read_pairs(arguments, planning.PlanRequest))


def main() -> None:
    """Entry point of `python -m ahnn.plan` and `ahnn-plan`."""
    run_command(plan, __doc__, logging.INFO)


if __name__ == "__main__":
    main()
