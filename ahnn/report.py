"""Report on runs in one HTML file: `python -m ahnn.report DIR...`, or `run=DIR` for a single run.

DIR                 a run folder, or one that holds runs at any depth; several are one report
run=DIR             a single run: scores, consistency, figures, settings
output=FOLDER       report/ in the first folder without it; one of an earlier report is written anew
report.figures=false            tables and claims alone
report.confidence=0.95          of the intervals that decide orders and claims

Written are report.html, which needs no network, tables.csv, tables/*.tex and figures/*.png, *.svg.
"""

from __future__ import annotations

from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing

USAGE = "usage: python -m ahnn.report DIR... | run=DIR [output=FOLDER]"


def report(arguments: list[str]) -> None:
    """Write the report that a command line asks for; raises as `cli.reporting`."""
    with importing():
        from ahnn.cli import reporting

    reporting.report(arguments, USAGE)


def main() -> None:
    """Entry point of `python -m ahnn.report` and `ahnn-report`."""
    run_command(report, __doc__)


if __name__ == "__main__":
    main()
