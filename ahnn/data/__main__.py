"""Check data before training or orbit determination: `python -m ahnn.data check PATH... [KEY=VALUE...]`.

PATH...        data files for system=files, docs/data.md, or tracking files, docs/tracking.md
figures=DIR    plot data and findings into a folder as PNG and SVG
mass=M         also gap, frame, step, duration: options of system=files

The exit code is 2 if a finding would spoil the training or the orbit, and 0 otherwise.
"""

from __future__ import annotations

from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing


def check(arguments: list[str]) -> None:
    """Check the files named on the command line; raises UserError for unknown options and for faults."""
    with importing():
        from ahnn.cli.data_files import read_check
        from ahnn.jobs import checking

    checking.check(*read_check(arguments))


def main() -> None:
    """Entry point of `python -m ahnn.data`."""
    run_command(check, __doc__)


if __name__ == "__main__":
    main()
