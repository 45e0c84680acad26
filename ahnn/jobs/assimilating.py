"""Assimilation of measurements of one object, line by line: input, output, state and display."""

from __future__ import annotations

import gc
import logging
from collections.abc import Sequence
from contextlib import closing, nullcontext
from io import BytesIO
from pathlib import Path
from typing import Any

import torch

from ahnn.assimilation import Assimilation, Catalogue
from ahnn.assimilation.assimilation_record import AssimilationRecord, read_record
from ahnn.assimilation.lines import Lines
from ahnn.assimilation.output_rows import Rows
from ahnn.assimilation.session import Session, Watcher
from ahnn.assimilation.stream_figures import figures_of
from ahnn.assimilation.view import View, summary
from ahnn.data.estimate_table import OF_FILTER, described, track_names
from ahnn.data.files import Ephemeris, write_oem
from ahnn.data.files.object_name import ObjectName
from ahnn.data.reference import Reference
from ahnn.data.start_states import UNKNOWN, Starts
from ahnn.evaluation.sinks.figure_files import FORMATS, drawn
from ahnn.files import write_atomically
from ahnn.jobs.assimilating_objects import assimilate_objects
from ahnn.jobs.assimilation_request import Stream, opened
from ahnn.jobs.control_times import warn_of_the_end
from ahnn.prediction.ephemeris_message import ephemerides
from ahnn.prediction.propagation import Prediction
from ahnn.types import Space
from ahnn.uncertainty import BEYOND

log = logging.getLogger("ahnn")

EVERY = 1000
"""Number of lines between saved states."""


def assimilate(stream: Stream) -> None:
    """Assimilate all lines of a stream, and write figures and the ephemeris message.

    Raises:
        UserError: a missing file, or one that does not match the saved state.
        TrainingError: the filter has diverged, or rejects most measurements.
    """
    options, space, filtering = stream.asked, stream.space, stream.filtering
    if isinstance(filtering, Catalogue):
        assimilate_objects(stream, filtering)
        return
    state = None if options.state is None else Path(options.state)
    followed = stream.followed
    source = opened(options.measurements, state) if followed is None else BytesIO(followed.content)
    with closing(Lines(source)) as lines:
        kind = options.format or ("json" if Path(options.output).suffix in (".json", ".jsonl") else "csv")
        names = {name: one.spoken for name, one in stream.objects.items()}
        beside = described(space, stream.reference, names)
        more = {"modes": len(filtering.modes), "lag": options.lag is not None, "scales": space.scales}
        more["clock"] = stream.clock
        rows = Rows(track_names(space), filtering.sensors, kind, beside, **more)
        given = options.output, state, options.every or EVERY, stream.clock, stream.controls
        session = Session(filtering, lines, rows, *given)
        session.fitted = stream.fitted
        session.undated = not (isinstance(options.start, str) or session.resumed) and options.time is None
        view = View(space) if options.watch else None
        gc.collect()
        gc.freeze()  # garbage collection of existing objects must not delay lines
        with view or nullcontext():
            watchers = [one for one in (view, followed) if one is not None]
            session.run(told_to(watchers) if watchers else None)
    if filtering.controls.known is not None:
        warn_of_the_end(options.controls, filtering.controls.known, filtering.window.time)
    log.info("%s lines: %s", f"{session.counts.total():,}", summary(session.counts))
    if verdict := session.verdict():
        log.info(verdict)
    for remark in session.of_sensors():
        log.warning(remark)
    if remark := _of_novelty(stream, filtering):
        log.warning(remark)
    for name, sensor in filtering.sensors.items():
        own = zip(sensor.columns, sensor.measurement.units, filtering.biases.get(name, ()), strict=False)
        biases = [f"{column} {b:.4g} ± {sd:.2g} {unit}" for column, unit, (b, sd) in own if sd > 0.0]
        if biases:
            log.info("bias of %s: %s", name, ", ".join(biases))
    if followed is not None:
        log.info("%s", "\n".join(followed.lines(filtering.window.state.moments, filtering.window.time)))
    _pictures(stream)
    session.require_followed()


def _of_novelty(stream: Stream, filtering: Assimilation) -> str | None:
    """Return a remark if the last estimate is beyond the training data; consistency does not reveal this."""
    mean = filtering.window.state.moments.mean[0, : filtering.size]
    far = 0.0 if stream.novelty is None else float(stream.novelty(mean))
    if far <= BEYOND:
        return None
    return (
        f"novelty: the last estimate lies beyond the training data, {far:.3g} times as far as its edge. "
        "Errors there may be far larger than the standard deviations"
    )


def told_to(watchers: Sequence[Watcher]) -> Watcher:
    """Return a watcher that notifies several watchers."""

    def tell(*values: Any) -> None:
        for one in watchers:
            one(*values)

    return tell


def _pictures(stream: Stream) -> None:
    """Write figures and the ephemeris message of the output, if requested."""
    options, space = stream.asked, stream.space
    if not (options.figures or options.oem):
        return
    record = read_record(Path(options.output), space)
    if options.figures:
        units: dict[str, str] = {}
        for one in stream.filtering.sensors.values():
            units |= dict(zip(one.columns, one.measurement.units, strict=False))
        for name, figure in figures_of(record, space, units, stream.reference).items():
            for suffix in FORMATS:
                write_atomically(Path(options.figures) / f"{name}{suffix}", drawn(figure, suffix))
    if options.oem:
        one = next(iter(stream.objects.values()), ObjectName(UNKNOWN))
        estimates = estimated(record, one, space, stream.reference)
        write_oem(Path(options.oem), estimates, comments=[OF_FILTER])


def estimated(
    record: AssimilationRecord, one: ObjectName, space: Space, reference: Reference
) -> list[Ephemeris]:
    """Return the estimates of an object with their covariances as the segment of an ephemeris message.

    Raises:
        UserError: see `ahnn.prediction.ephemeris_message.require_orbit`.
    """
    time, mean, covariance = (torch.from_numpy(part) for part in record[:3])
    named = (one._replace(name=one.spoken),)
    begin = Starts(named, mean[:1], torch.zeros(1, dtype=torch.float64), reference)
    return ephemerides(Prediction(time, mean[None], covariance[None]), begin, space)
