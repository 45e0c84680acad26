"""Report command."""

from __future__ import annotations

from pathlib import Path

from ahnn.cli.build import build
from ahnn.cli.compose import composed
from ahnn.cli.pairs import divided
from ahnn.errors import UserError, WrongUsage
from ahnn.evaluation.results import FILE
from ahnn.evaluation.terminal import show
from ahnn.manifest import require_plain


def report(arguments: list[str]) -> None:
    """Write the report of the runs in given folders.

    Raises:
        UserError: no runs, an unknown key, or a folder with other content.
    """
    given, pairs = divided(arguments)
    cfg = composed("report", pairs)
    if (cfg.run is None) == (not given):
        message = f"received {'both' if given else 'neither'}"
        raise WrongUsage(message)
    if cfg.run is not None and not (Path(str(cfg.run)) / FILE).is_file():
        message = (
            f"run={cfg.run}: expected one evaluated run; received no {FILE} there. Leave out run= for "
            "several runs"
        )
        raise UserError(message)
    folders = given or [Path(str(cfg.run))]
    output = folders[0] / "report" if cfg.output is None else Path(str(cfg.output))
    if cfg.output is None:
        require_plain(output)
    show(build(cfg.report, "report")(folders, output))
