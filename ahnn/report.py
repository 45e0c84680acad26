"""Report on runs in one HTML file: `python -m ahnn.report DIR...`, or `run=DIR` for a single run.

DIR                 a run folder, or one that holds runs at any depth; several are one report
run=DIR             a single run: scores, consistency, figures, settings
output=FOLDER       report/ in the first folder without it; one of an earlier report is written anew
report.figures=false            tables and claims alone
report.confidence=0.95          of the intervals that decide orders and claims

Written are report.html, which needs no network, tables.csv, tables/*.tex and figures/*.png, *.svg.
"""

from __future__ import annotations

if __name__ == "__main__":  # until `guard` listens, Ctrl-C ends this process without a traceback
    import signal

    signal.signal(signal.SIGINT, signal.SIG_DFL)

from pathlib import Path

from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing

USAGE = "usage: python -m ahnn.report DIR... | run=DIR [output=FOLDER]"


def report(arguments: list[str]) -> None:
    """Write the report of the runs in some folders.

    Raises:
        UserError: no runs, an unknown key, or a folder of something else.
    """
    with importing():
        from ahnn.cli.build import build
        from ahnn.cli.compose import composed
        from ahnn.errors import UserError
        from ahnn.evaluation.results import FILE
        from ahnn.evaluation.terminal import show
        from ahnn.manifest import require_plain

    given = [text for text in arguments if "=" not in text or Path(text).is_dir()]
    cfg = composed("report", [text for text in arguments if text not in given])
    if (cfg.run is None) == (not given):
        message = f"{USAGE}; received {'both' if given else 'neither'}"
        raise UserError(message)
    if cfg.run is not None and not (Path(str(cfg.run)) / FILE).is_file():
        message = (
            f"run={cfg.run}: expected one evaluated run; received no {FILE} there. Leave out run= for many"
        )
        raise UserError(message)
    folders = [Path(text) for text in given] or [Path(str(cfg.run))]
    output = folders[0] / "report" if cfg.output is None else Path(str(cfg.output))
    if cfg.output is None:
        require_plain(output)
    show(build(cfg.report, "report")(folders, output))


def main() -> None:
    """Entry point of `python -m ahnn.report` and `ahnn-report`."""
    run_command(report, __doc__)


if __name__ == "__main__":
    main()
