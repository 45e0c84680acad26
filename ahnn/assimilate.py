"""Assimilate measurements online: `python -m ahnn.assimilate run=DIR measurements=FILE|- start=[..]|FILE`.

run=DIR             a run folder; or pretrained=NAME, a model that comes with the package; ckpt=best
measurements=FILE   CSV with a header (time, sensor, numbers, sd_NAME) or JSON lines; - is standard input
start=[X,...]       the state at time=0; or FILE: YAML or JSON (mean, sd or covariance), an ephemeris, table,
                    element set, or what an assimilation wrote, with its epoch, frame and covariance
start_sd=[..]       its standard deviations, one for each component (of one degree of freedom q and p), or
                    [position,velocity], in place of a covariance in FILE
epoch=2024-03-01T12:00:00       of time zero; else that of the data of the run, or of the start
frame=EME2000       also center=EARTH, time_system=UTC: where neither the run nor the start says them
output=FILE         estimate and covariance after each line, CSV or JSON lines; else standard output
state=FILE          saved every 1000 lines (every=N); the same command goes on with it after any stop
window=SECONDS      late measurements are merged by replay; lines=N are kept for that at most
measurement=NAME    what is measured; of several sensors: +measurement@sensors.NAME=OPTION for each
plugins=NAME        the filter; plugins.ukf.gate=0.9999 refuses outliers, plugins.ukf.process_noise is Q
watch=true          a live view of state, 3 sigma, innovations and NIS on standard error; or --watch
figures=FOLDER      innovations, consistency and deviations at the end
oem=FILE            .oem or .xml: an ephemeris message at the end, of object=NAME
--trust             build whatever the folder's config.yaml names; only if you know who wrote it
"""

from __future__ import annotations

if __name__ == "__main__":  # until `guard` listens, Ctrl-C ends this process without a traceback
    import signal

    signal.signal(signal.SIGINT, signal.SIG_DFL)

import gc
import logging
import sys
from contextlib import closing, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, BinaryIO, Literal, cast

from ahnn.arguments import Count, Finite, Positive, Within
from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing
from ahnn.cli.stops import ended

if TYPE_CHECKING:
    from ahnn.assimilation.journal import Journal
    from ahnn.cli.stream import Built
    from ahnn.types import Space

log = logging.getLogger("ahnn")

USAGE = "usage: python -m ahnn.assimilate run=DIR | pretrained=NAME measurements=FILE|- start=FILE|[..]"


@dataclass(frozen=True, kw_only=True)
class Asked:
    """The keys of conf/assimilate.yaml."""

    measurements: str
    output: str
    format: Literal["csv", "json"] | None = None
    state: str | None = None
    every: Count
    start: str | list[float] | None = None
    start_sd: list[Positive] | None = None
    time: Finite | None = None
    sensors: dict[str, Any]
    window: Annotated[float, Within(0)]
    lines: Count
    gap: Positive | None = None
    watch: bool
    figures: str | None = None
    oem: str | None = None
    object: str | None = None
    epoch: str | None = None
    frame: str | None = None
    center: str | None = None
    time_system: str | None = None


def assimilate(arguments: list[str]) -> None:
    """Assimilate a stream with the weights of a run.

    Raises:
        UserError: no such run or file, or options that do not go together.
        TrainingError: the filter has diverged.
    """
    with importing():
        import torch

        from ahnn.assimilation.lines import Lines
        from ahnn.assimilation.rows import Rows, require_new
        from ahnn.assimilation.session import Session
        from ahnn.assimilation.view import View, said
        from ahnn.cli import stream
        from ahnn.cli.again import run_config
        from ahnn.cli.unread import refuse, unread_online
        from ahnn.data.tracks import described
        from ahnn.errors import UserError
        from ahnn.runs import load

    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    log.setLevel(logging.INFO)
    options, nodes, request = stream.asked(arguments, Asked, USAGE)
    if options.output == "-" and (options.figures or options.oem):
        message = "output: expected a FILE, of which figures and oem are made; received -"
        raise UserError(message)
    run = load(request.source, request.ckpt)
    cfg = run_config(run.folder, stream.with_filter(request, run))
    refuse(unread_online(cfg.plugins, covariance=run.uncertainty is not None), request.overrides)
    torch.set_num_threads(cfg.threads)
    state = None if options.state is None else Path(options.state)
    if state is None or not state.exists():
        require_new(options.output)
    _require_places(options)
    with closing(Lines(_opened(options.measurements, state))) as lines:
        built = stream.build_assimilation(options, nodes, cfg, run)
        kind = options.format or ("json" if Path(options.output).suffix in (".json", ".jsonl") else "csv")
        beside = described(run.space, built.reference)
        rows = Rows(run.space.components, built.filtering.sensors, kind, beside)
        session = Session(built.filtering, lines, rows, options.output, state, options.every, built.clock)
        view = View(run.space) if options.watch else None
        kept = ended(lambda: "the same command goes on where it was") if state else nullcontext()
        gc.collect()
        gc.freeze()  # no line waits while the collector looks through what is there
        with kept, view or nullcontext():
            session.run(view)
    log.info("%s lines: %s", f"{session.counted:,}", said(session.counts))
    if verdict := session.verdict():
        log.info(verdict)
    _pictures(options, run.space, built)


def _opened(path: str, state: Path | None) -> BinaryIO | Journal:
    """Return a stream of bytes, standard input with a journal beside its state."""
    from ahnn.assimilation.journal import Journal

    if path != "-":
        return open(path, "rb")
    pipe = cast(Any, sys.stdin.buffer)
    return pipe if state is None else Journal(pipe.raw, Path(f"{state}.lines"))


def _require_places(options: Asked) -> None:
    """Refuse places for state, figures and message where something else is; raises UserError."""
    from ahnn.errors import UserError
    from ahnn.manifest import require_own

    if options.state is not None and Path(options.state).is_symlink():
        message = f"state: expected a file; received {options.state}, a link. Name the file itself"
        raise UserError(message)
    given = [Path(path).resolve() for path in (options.output, options.state, options.oem) if path]
    if len({*given}) < len(given):
        message = "assimilate: expected an output, a state and an oem of their own; received one path twice"
        raise UserError(message)
    require_own(_made_at_the_end(options), "assimilate")


def _made_at_the_end(options: Asked) -> list[Path]:
    """Return the files that are made of the output."""
    from ahnn.assimilation.figures import NAMES
    from ahnn.evaluation.sinks.figures import FORMATS

    names = [f"{name}{suffix}" for name in NAMES for suffix in FORMATS]
    pictures = [Path(options.figures) / name for name in names] if options.figures else []
    return [*pictures, *([Path(options.oem)] if options.oem else [])]


def _pictures(options: Asked, space: Space, built: Built) -> None:
    """Make figures and message of the output, if they are asked for."""
    if not (options.figures or options.oem):
        return
    from ahnn.assimilation.figures import figures_of
    from ahnn.assimilation.record import read_record, write_ephemeris
    from ahnn.evaluation.sinks.figures import FORMATS, drawn
    from ahnn.files import write_atomically

    record = read_record(Path(options.output), space.components)
    if options.figures:
        for name, figure in figures_of(record, space).items():
            for suffix in FORMATS:
                write_atomically(Path(options.figures) / f"{name}{suffix}", drawn(figure, suffix))
    if options.oem:
        write_ephemeris(Path(options.oem), record, space, built.name, built.reference)


def main() -> None:
    """Entry point of `python -m ahnn.assimilate` and `ahnn-assimilate`."""
    run_command(assimilate, __doc__)


if __name__ == "__main__":
    main()
