"""A stream of measurements, filtered line by line: what is read, written, saved and shown."""

from __future__ import annotations

import gc
import logging
import sys
from contextlib import closing, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, BinaryIO, Literal, NamedTuple, cast

from ahnn.arguments import Count, Finite, Positive, Within
from ahnn.assimilation import Assimilation
from ahnn.assimilation.assimilation_record import read_record, write_ephemeris
from ahnn.assimilation.journal import Journal
from ahnn.assimilation.lines import Lines
from ahnn.assimilation.output_rows import Rows, require_new
from ahnn.assimilation.session import Session
from ahnn.assimilation.stream_clock import StreamClock
from ahnn.assimilation.stream_figures import NAMES, figures_of
from ahnn.assimilation.view import View, said
from ahnn.data.estimate_table import described
from ahnn.data.reference import Reference
from ahnn.errors import UserError
from ahnn.evaluation.sinks.figure_files import FORMATS, drawn
from ahnn.files import write_atomically
from ahnn.jobs.control_times import warn_of_the_end
from ahnn.manifest import require_own
from ahnn.types import Space

log = logging.getLogger("ahnn")


@dataclass(frozen=True, kw_only=True)
class AssimilationRequest:
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
    controls: str | list[Finite] | Finite | None = None
    epoch: str | None = None
    frame: str | None = None
    center: str | None = None
    time_system: str | None = None


class Stream(NamedTuple):
    """All that an assimilation needs besides its lines.

    Attributes:
        asked: where lines come from, and what is made of them.
        space: of the states.
        filtering: the filter.
        clock: what times mean.
        reference: of the estimates.
        name: of what is followed.
        controls: names of those that forces of the model take.
    """

    asked: AssimilationRequest
    space: Space
    filtering: Assimilation
    clock: StreamClock
    reference: Reference
    name: str
    controls: tuple[str, ...] = ()


def assimilate(stream: Stream) -> None:
    """Assimilate all lines of a stream, and make the figures and the message of the output.

    Raises:
        UserError: no such file, or one that is not what a saved state was made of.
        TrainingError: the filter has diverged.
    """
    options, space, filtering = stream.asked, stream.space, stream.filtering
    state = None if options.state is None else Path(options.state)
    with closing(Lines(_opened(options.measurements, state))) as lines:
        kind = options.format or ("json" if Path(options.output).suffix in (".json", ".jsonl") else "csv")
        beside = described(space, stream.reference)
        rows = Rows(space.components, filtering.sensors, kind, beside)
        given = options.output, state, options.every, stream.clock, stream.controls
        session = Session(filtering, lines, rows, *given)
        view = View(space) if options.watch else None
        gc.collect()
        gc.freeze()  # no line waits while the collector looks through what is there
        with view or nullcontext():
            session.run(view)
    if filtering.controls.known is not None:
        warn_of_the_end(options.controls, filtering.controls.known, filtering.window.time)
    log.info("%s lines: %s", f"{session.counted:,}", said(session.counts))
    if verdict := session.verdict():
        log.info(verdict)
    for name, sensor in filtering.sensors.items():
        own = zip(sensor.columns, sensor.measurement.units, filtering.biases.get(name, ()), strict=False)
        told = [f"{column} {b:.4g} ± {sd:.2g} {unit}" for column, unit, (b, sd) in own if sd > 0.0]
        if told:
            log.info("bias of %s: %s", name, ", ".join(told))
    _pictures(stream)


def require_places(options: AssimilationRequest) -> None:
    """Refuse places for output, state, figures and message where something else is; raises UserError."""
    if options.output == "-" and (options.figures or options.oem):
        message = "output: expected a FILE, of which figures and oem are made; received -"
        raise UserError(message)
    if options.state is None or not Path(options.state).exists():
        require_new(options.output)
    if options.state is not None and Path(options.state).is_symlink():
        message = f"state: expected a file; received {options.state}, a link. Name the file itself"
        raise UserError(message)
    given = [Path(path).resolve() for path in (options.output, options.state, options.oem) if path]
    if len({*given}) < len(given):
        message = "assimilate: expected an output, a state and an oem of their own; received one path twice"
        raise UserError(message)
    require_own(_made_at_the_end(options), "assimilate")


def _opened(path: str, state: Path | None) -> BinaryIO | Journal:
    """Return a stream of bytes, standard input with a journal beside its state."""
    if path != "-":
        return open(path, "rb")
    pipe = cast(Any, sys.stdin.buffer)
    return pipe if state is None else Journal(pipe.raw, Path(f"{state}.lines"))


def _made_at_the_end(options: AssimilationRequest) -> list[Path]:
    """Return the files that are made of the output."""
    names = [f"{name}{suffix}" for name in NAMES for suffix in FORMATS]
    pictures = [Path(options.figures) / name for name in names] if options.figures else []
    return [*pictures, *([Path(options.oem)] if options.oem else [])]


def _pictures(stream: Stream) -> None:
    """Make figures and message of the output, if they are asked for."""
    options, space = stream.asked, stream.space
    if not (options.figures or options.oem):
        return
    record = read_record(Path(options.output), space.components)
    if options.figures:
        for name, figure in figures_of(record, space).items():
            for suffix in FORMATS:
                write_atomically(Path(options.figures) / f"{name}{suffix}", drawn(figure, suffix))
    if options.oem:
        write_ephemeris(Path(options.oem), record, space, stream.name, stream.reference)
