"""Request and prepared stream of an assimilation."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, BinaryIO, Literal, NamedTuple, cast

from torch import Tensor

from ahnn.arguments import Count, Finite, Positive, Within
from ahnn.assimilation import Assimilation, Catalogue
from ahnn.assimilation.journal import Journal
from ahnn.assimilation.output_rows import require_new
from ahnn.assimilation.stream_clock import StreamClock
from ahnn.assimilation.stream_figures import NAMES
from ahnn.data.files.object_name import ObjectName
from ahnn.data.reference import Reference
from ahnn.errors import UserError
from ahnn.evaluation.sinks.figure_files import FORMATS
from ahnn.jobs.followed_measurements import FollowedMeasurements
from ahnn.manifest import require_own
from ahnn.types import Space

STATED = "frame=EME2000", "center=EARTH", "time_system=UTC", "epoch=2024-03-01T12:00:00"
"""Options that state the reference of an ephemeris message."""


@dataclass(frozen=True, kw_only=True)
class AssimilationRequest:
    """The keys of conf/assimilate.yaml."""

    measurements: str
    orbit: str | None = None
    folder: str | None = None
    fitted: Positive | None = None
    output: str
    format: Literal["csv", "json"] | None = None
    state: str | None = None
    every: Count | None = None
    objects: str | None = None
    shard: str | None = None
    workers: int | str | None = None
    states: str | None = None
    start: str | list[float] | None = None
    start_sd: list[Positive] | None = None
    time: Finite | str | None = None
    sensors: dict[str, Any]
    stations: str | None = None
    window: Annotated[float, Within(0)]
    lines: Count
    gap: Positive | None = None
    lag: Positive | None = None
    gate: Annotated[float, Within(above=0, below=1)] | Literal["none"] | None = None
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
    """Prepared assimilation, without its lines.

    Attributes:
        asked: request with input and outputs.
        space: space of the states.
        filtering: filter of one object, or filters of many.
        clock: interpretation of times.
        reference: reference of the estimates.
        objects: tracked objects by their identifiers, as far as known.
        controls: names of the model's controls.
        followed: measurements of an orbit determination, used instead of lines.
        fitted: number of the last line to which the start was fitted.
        novelty: distance of states from the training data, 1 at their edge; None if unknown.
    """

    asked: AssimilationRequest
    space: Space
    filtering: Assimilation | Catalogue
    clock: StreamClock
    reference: Reference
    objects: dict[str, ObjectName]
    controls: tuple[str, ...] = ()
    followed: FollowedMeasurements | None = None
    fitted: int = 0
    novelty: Callable[[Tensor], Tensor] | None = None


def require_places(options: AssimilationRequest) -> None:
    """Raise UserError for invalid or occupied paths of output, state, figures and message."""
    require_together(options)
    if options.output == "-" and (options.figures or options.oem):
        message = "output: expected a FILE for figures and oem, which are made from it; received -"
        raise UserError(message)
    if options.state is None or not Path(options.state).exists():
        require_new(options.output)
    if options.state is not None and Path(options.state).is_symlink():
        message = f"state: expected a file; received {options.state}, a link. Name the file itself"
        raise UserError(message)
    places = options.output, options.state, options.states, options.oem
    given = [Path(path).resolve() for path in places if path]
    if len({*given}) < len(given):
        message = (
            "assimilate: expected different paths for output, state and other files; received one path twice"
        )
        raise UserError(message)
    require_own(_made_at_the_end(options), "assimilate")


def require_together(options: AssimilationRequest) -> None:
    """Raise UserError for options of single-object streams combined with options for many objects."""
    if options.objects is None:
        for key in ("states", "shard", "workers"):
            if (value := getattr(options, key)) is not None:
                message = f"{key}: expected objects=COLUMN with {key}={value}; received no objects"
                raise UserError(message)
        return
    one = {key: getattr(options, key) for key in ("figures", "oem", "object", "controls", "lag")}
    one["watch"] = options.watch or None
    if given := [key for key, value in one.items() if value is not None]:
        message = f"{given[0]}: expected none with objects={options.objects}; received one. Leave it out"
        raise UserError(message)


def opened(path: str, state: Path | None) -> BinaryIO | Journal:
    """Open a byte stream; standard input with a state has a journal next to the state."""
    if path != "-":
        return open(path, "rb")
    pipe = cast(Any, sys.stdin.buffer)
    return pipe if state is None else Journal(pipe.raw, Path(f"{state}.lines"))


def _made_at_the_end(options: AssimilationRequest) -> list[Path]:
    """Return the files that are made from the output at the end."""
    names = [f"{name}{suffix}" for name in NAMES for suffix in FORMATS]
    pictures = [Path(options.figures) / name for name in names] if options.figures else []
    return [*pictures, *([Path(options.oem)] if options.oem else [])]
