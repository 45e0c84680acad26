"""Report on runs in one HTML file: `python -m ahnn.report DIR... | run=DIR [output=FOLDER]`.

DIR                 a run folder, or a folder containing runs at any depth; several form one report
run=DIR             a single run: scores, consistency, figures, settings
output=FOLDER       default: report/ in the first folder; an earlier report is replaced
report.figures=false            tables and claims only
report.confidence=0.95          confidence level of the intervals behind rankings and claims

Output: report.html, readable offline, tables.csv, tables/*.tex and figures/*.png, *.svg, *.pdf.
"""

from __future__ import annotations

from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing


def report(arguments: list[str]) -> None:
    """Write the report requested on the command line; raises the same errors as `cli.reporting`."""
    with importing():
        from ahnn.cli import reporting

    reporting.report(arguments)


def main() -> None:
    """Entry point of `python -m ahnn.report` and `ahnn-report`."""
    run_command(report, __doc__)


if __name__ == "__main__":
    main()
