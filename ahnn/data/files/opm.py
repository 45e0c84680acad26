"""Orbit parameter messages (CCSDS 502.0-B): one state with its covariance, as an ephemeris of one state."""

from __future__ import annotations

from ahnn.data.files.ccsds_fields import FieldMessage, field_messages
from ahnn.data.files.ephemeris import COMPONENTS, REQUIRED, MessageBlock
from ahnn.data.files.oem_xml import TRIANGLE, unit_of
from ahnn.data.files.table import Note, Remark, refuse

META = (*REQUIRED, "OBJECT_NAME", "REF_FRAME_EPOCH")
UNUSED = (
    *(
        "SEMI_MAJOR_AXIS",
        "ECCENTRICITY",
        "INCLINATION",
        "RA_OF_ASC_NODE",
        "ARG_OF_PERICENTER",
        "TRUE_ANOMALY",
    ),
    *("MEAN_ANOMALY", "GM", "MASS", "SOLAR_RAD_AREA", "SOLAR_RAD_COEFF", "DRAG_AREA", "DRAG_COEFF"),
)
"""Optional content of a message besides its state."""


def opm_blocks(text: str, file: str, note: Note = refuse) -> list[MessageBlock]:
    """Return each message of a text as a segment of one state.

    Args:
        text: text of one or several messages, in either notation.
        file: file name.
        note: callback for non-standard keywords and unused manoeuvres.

    Raises:
        UserError: missing or wrong content; the message gives its line number.
    """
    return [_block(one, note) for one in field_messages(text, file, "OPM")]


def _block(one: FieldMessage, note: Note) -> MessageBlock:
    """Return the state and the covariance of a message; raises Fault if incomplete."""
    one.require_units(unit_of)
    block = MessageBlock(one.place)
    block.meta = {key: one.text(key) for key in REQUIRED}
    block.meta |= {key: one.values[key] for key in META if one.values.get(key)}
    cells = [one.text(key) for key in ("EPOCH", *COMPONENTS)]
    block.vectors.append((one.rows["EPOCH"], cells))
    given = [key for key in TRIANGLE if key in one.values]
    if given:
        row, frame = one.rows[given[0]], one.values.get("COV_REF_FRAME", "")
        block.matrices.append((row, cells[0], frame, [one.text(key) for key in TRIANGLE]))
    block.unused |= dict.fromkeys(key for key in UNUSED if key in one.values)
    block.unused |= dict.fromkeys(key for key in one.repeated if not key.startswith("MAN_"))
    if burns := [key for key in one.repeated if key.startswith("MAN_")]:
        note(Remark(one.place, f"manoeuvres not used: {', '.join(burns)}", "", "warning"))
    known = (*META, "EPOCH", *COMPONENTS, *TRIANGLE, "COV_REF_FRAME", *UNUSED)
    if other := one.unknown(known):
        what = f"not OPM keywords, ignored: {', '.join(other)}"
        note(Remark(one.place, what, "Correct them, or leave them out", "warning"))
    return block
