"""Look data over before anything is learned from them: `python -m ahnn.data check PATH...`.

PATH...        files as system=files reads them, docs/data.md
figures=DIR    draw them, with what was found, into a folder as PNG and SVG
mass=M         and gap, frame, step, duration: the keys of system=files

It ends with 2 where something would spoil a training, and with 0 where nothing would.
"""

from __future__ import annotations

if __name__ == "__main__":  # until `guard` listens, Ctrl-C ends this process without a traceback
    import signal

    signal.signal(signal.SIGINT, signal.SIG_DFL)

from pathlib import Path
from typing import Any

from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing

USAGE = "usage: python -m ahnn.data check PATH... [figures=DIR] [mass=M] [gap=10] [frame=GCRF] [key=value]"
KEYS = ("mass", "gap", "frame", "step", "duration")


def check(arguments: list[str]) -> None:
    """Show all that is wrong with files.

    Raises:
        UserError: something that would spoil a training, or a mistake in the command.
    """
    with importing():
        from ahnn.data.doctor import examine
        from ahnn.data.files.reading import Reading
        from ahnn.errors import UserError
        from ahnn.evaluation.checkup import checkup, draw
        from ahnn.evaluation.terminal import show
        from ahnn.files import require_writable

    paths, options = request(arguments)
    figures = Path(str(options.pop("figures"))) if "figures" in options else None
    if figures is not None:
        require_writable(figures)
    mass, gap = options.pop("mass", None), options.pop("gap", 10.0)
    found = examine(paths, Reading(mass is not None, **options), mass, gap)
    show(checkup(found))
    if figures is not None:
        draw(found, figures)
    if count := len(found.faults):
        what = "1 fault that would" if count == 1 else f"{count} faults that would"
        message = f"check: expected sound data; received {what} spoil a training"
        raise UserError(message)


def request(arguments: list[str]) -> tuple[list[Path], dict[str, Any]]:
    """Return the files and the options of a command line; raises UserError for others."""
    from ahnn.arguments import check_values, nearest
    from ahnn.cli.commandline import pair
    from ahnn.data.files import Files
    from ahnn.errors import UserError

    known = [argument for argument in arguments[1:] if is_option(argument)]
    keys = [argument.partition("=")[0] for argument in known]
    if unknown := [key for key in keys if key not in (*KEYS, "figures")]:
        message = f"check: unknown key {unknown[0]!r}{nearest(unknown[0], (*KEYS, 'figures'))}"
        raise UserError(message)
    options = dict(pair(argument) for argument in known)
    paths = [Path(argument).expanduser() for argument in arguments[1:] if argument not in known]
    if arguments[:1] != ["check"] or not paths:
        message = f"{USAGE}; received: {' '.join(arguments) or 'nothing'}"
        raise UserError(message)
    check_values("", Files, {key: value for key, value in options.items() if key in KEYS})
    return paths, options


def is_option(argument: str) -> bool:
    """Return whether an argument is key=value, and not a path with that sign in it."""
    key, sign, _ = argument.partition("=")
    return bool(sign) and (key in (*KEYS, "figures") or not Path(argument).expanduser().exists())


def main() -> None:
    """Entry point of `python -m ahnn.data`."""
    run_command(check, __doc__)


if __name__ == "__main__":
    main()
