"""CCSDS orbit ephemeris messages (CCSDS 502.0-B) in keyword = value notation, reading and writing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from ahnn.data.files import epochs
from ahnn.data.files.ephemeris import (
    ACCELERATION,
    ALONE,
    HEADER,
    Covariance,
    Ephemeris,
    MessageBlock,
    check_version,
)
from ahnn.data.files.table import Fault, Note, Place, refuse

VERSION = "CCSDS_OEM_VERS"


def blocks_of(text: str, file: str, note: Note = refuse) -> list[MessageBlock]:
    """Split a message into segments of text.

    Args:
        text: text of the message.
        file: file name.
        note: callback for states with a wrong number of values, which are then skipped.

    Raises:
        UserError: unexpected content (the message gives its line number), or an error raised by `note`.
    """
    lines = [(row, line.strip()) for row, line in enumerate(text.split("\n"), 1)]
    used = [(row, line) for row, line in lines if line and not line.startswith("COMMENT")]
    if not used or not used[0][1].startswith(VERSION):
        Place(file, used[0][0] if used else 0).refuse(
            f"{VERSION} first", repr(used[0][1]) if used else "no line"
        )
    blocks: list[MessageBlock] = []
    state = "header"
    for row, line in used:
        place = Place(file, row)
        if line == "META_START" and state in ("header", "data"):
            blocks.append(MessageBlock(place))
            state = "meta"
        elif (line, state) in CHANGES:
            state = CHANGES[line, state]
        elif state == "header":
            check_header(*pair(line, place), place, first=row == used[0][0])
        elif state == "meta":
            blocks[-1].say(*pair(line, place), place)
        elif state == "data":
            add_vector(blocks[-1], line, place, note)
        else:
            add_covariance(blocks[-1], line, place)
    if state != "data":
        Place(file, used[-1][0]).refuse("a segment from META_START to its states", f"the end of its {state}")
    blocks[0].comments = [line[len("COMMENT") :].strip() for _, line in lines if line.startswith("COMMENT")]
    return blocks


def check_header(key: str, value: str, place: Place, *, first: bool) -> None:
    """Raise UserError for unexpected content before the first segment."""
    if first:
        check_version(value, place)
    elif key not in HEADER:
        place.refuse(f"{', '.join(HEADER)} or META_START", repr(key), ALONE)


CHANGES = {
    ("META_STOP", "meta"): "data",
    ("COVARIANCE_START", "data"): "covariance",
    ("COVARIANCE_STOP", "covariance"): "data",
}
"""Next state of the parser, by line and current state."""


def pair(line: str, place: Place) -> tuple[str, str]:
    """Return keyword and value; raises UserError for other lines."""
    key, sign, value = (part.strip() for part in line.partition("="))
    if not sign:
        place.refuse("KEYWORD = value", repr(line))
    return key, value


def add_vector(block: MessageBlock, line: str, place: Place, note: Note) -> None:
    """Add a state to a block, or report a wrong number of values to `note`; accelerations are ignored."""
    cells = line.split()
    if "=" in line:
        place.refuse("a state, a covariance or META_START", repr(line), ALONE)
    if len(cells) in (7, 10):
        block.vectors.append((place.row, cells))
        block.unused |= dict.fromkeys(ACCELERATION if len(cells) == 10 else ())
    else:
        expected = "an epoch, three positions and three velocities"
        note(Fault(place, expected, f"{len(cells)} values"))


def add_covariance(block: MessageBlock, line: str, place: Place) -> None:
    """Add a line of a covariance to a block; raises UserError for numbers without a preceding epoch."""
    if "=" not in line:
        if not block.matrices:
            place.refuse("EPOCH = first in a covariance", repr(line))
        block.matrices[-1][3].extend(line.split())
        return
    key, value = pair(line, place)
    if key == "EPOCH":
        block.matrices.append((place.row, value, "", []))  # a frame is given for each covariance
    elif key == "COV_REF_FRAME" and block.matrices:
        row, epoch, _, cells = block.matrices[-1]
        block.matrices[-1] = (row, epoch, value, cells)
    else:
        place.refuse("EPOCH or COV_REF_FRAME", repr(key))


def written(
    ephemerides: Iterable[Ephemeris],
    originator: str = "ahnn",
    created: str | None = None,
    comments: Iterable[str] = (),
) -> str:
    """Format a message of version 2.0, with 16 digits per number, i.e. full precision.

    Args:
        ephemerides: one ephemeris per segment.
        originator: originator of the message.
        created: epoch of the message in UTC; None for now.
        comments: comments of the header, each of one line.
    """
    about = (f"COMMENT {line}" for line in comments)
    head = [f"CREATION_DATE = {created or epochs.now()}", f"ORIGINATOR = {originator}"]
    return (
        "\n".join(
            [f"{VERSION} = 2.0", *about, *head, *(line for one in ephemerides for line in _segment(one))]
        )
        + "\n"
    )


def _segment(one: Ephemeris) -> Iterator[str]:
    yield from ("", "META_START", *(f"{key} = {value}" for key, value in one.metadata().items()))
    yield from ("META_STOP", "")
    for time, state in zip(one.times, one.states, strict=True):
        yield " ".join([one.epoch(float(time)), *(f"{value:.15e}" for value in state)])
    if one.covariances:
        yield "COVARIANCE_START"
        for covariance in one.covariances:
            yield from _matrix(one, covariance)
        yield "COVARIANCE_STOP"


def _matrix(one: Ephemeris, covariance: Covariance) -> Iterator[str]:
    yield f"EPOCH = {one.epoch(covariance.time)}"
    yield f"COV_REF_FRAME = {covariance.frame or one.frame}"
    for k, row in enumerate(np.asarray(covariance.matrix)):
        yield " ".join(f"{value:.15e}" for value in row[: k + 1])
