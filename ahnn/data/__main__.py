"""Look data over before anything is learned from them: `python -m ahnn.data check PATH...`.

PATH...        files as system=files reads them, docs/data.md, or of tracking, docs/tracking.md
figures=DIR    draw them, with what was found, into a folder as PNG and SVG
mass=M         and gap, frame, step, duration: the keys of system=files

It ends with 2 where something would spoil a training or an orbit, and with 0 where nothing would.
"""

from __future__ import annotations

from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing

USAGE = "usage: python -m ahnn.data check PATH... [figures=DIR] [mass=M] [gap=10] [frame=GCRF] [key=value]"


def check(arguments: list[str]) -> None:
    """Check the files that a command line names; raises as `cli.data_files` and `jobs.checking`."""
    with importing():
        from ahnn.cli.data_files import read_check
        from ahnn.jobs import checking

    checking.check(*read_check(arguments, USAGE))


def main() -> None:
    """Entry point of `python -m ahnn.data`."""
    run_command(check, __doc__)


if __name__ == "__main__":
    main()
