"""Parquet files as tables with the columns of CSV files, and units in names or field metadata."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ahnn.data.files.table import Note, Place, Remark, Sheet, header_of, refuse
from ahnn.optional_libraries import library

INDEX = "__index_level_"
"""Name given by pandas to an unnamed index column."""


def read_parquet(raw: bytes, file: str, note: Note = refuse) -> Sheet:
    """Read the columns of a Parquet file; rows are numbered from 1.

    Args:
        raw: content of the file.
        file: file name, for messages.
        note: callback for an unused index and unused metadata.

    Raises:
        UserError: not Parquet, a column of an unsupported type, or contradictory units.
    """
    arrow = library("pyarrow", "pyarrow", "parquet", file)
    reader = library("pyarrow.parquet", "pyarrow", "parquet", file)
    try:
        table = reader.read_table(arrow.BufferReader(raw))
    except (arrow.ArrowInvalid, OSError) as error:
        Place(file).refuse("a Parquet file", " ".join(str(error).split()))
    place = Place(file)
    if index := [name for name in table.column_names if name.startswith(INDEX)]:
        note(Remark(place, f"not used: the pandas index {', '.join(index)}"))
        table = table.drop_columns(index)
    header = header_of(table.column_names, place)
    units = []
    for name, unit, field in zip(header.names, header.units, table.schema, strict=True):
        said = (field.metadata or {}).get(b"unit")
        text = unit if said is None else said.decode()
        if unit not in (None, text):
            place._replace(column=name).refuse(f"[{text}], as in its metadata", f"[{unit}]", "State it once")
        units.append(text)
        if other := [key.decode(errors="replace") for key in field.metadata or {} if key not in OURS]:
            note(Remark(place._replace(column=name), f"not used: metadata {', '.join(other)}"))
    columns = [cells(arrow, table.column(k), place._replace(column=n)) for k, n in enumerate(header.names)]
    rows = np.arange(1, table.num_rows + 1, dtype=np.int64)
    return Sheet(header._replace(units=tuple(units)), place, rows, columns)


OURS = (b"unit", b"PARQUET:field_id")


def cells(arrow: Any, column: Any, place: Place) -> Sequence[str] | NDArray[np.float64]:
    """Return the cells of a column, NaN or "" where missing; raises UserError for unsupported types."""
    kind = column.type
    if arrow.types.is_floating(kind):
        return column.cast(arrow.float64()).to_numpy()
    if arrow.types.is_integer(kind) or arrow.types.is_decimal(kind):
        return [str(value) if value is not None else "" for value in column.to_pylist()]
    if arrow.types.is_timestamp(kind) or arrow.types.is_date(kind):
        return [value or "" for value in column.cast(arrow.string()).to_pylist()]
    if arrow.types.is_string(kind) or arrow.types.is_large_string(kind) or arrow.types.is_dictionary(kind):
        return [value or "" for value in column.cast(arrow.string()).to_pylist()]
    place.refuse("numbers, texts or times", str(kind))


def packed_table(columns: dict[str, Any]) -> bytes:
    """Return columns as a Parquet file, in memory; raises UserError without pyarrow."""
    arrow = library("pyarrow", "pyarrow", "parquet", "output")
    writer = library("pyarrow.parquet", "pyarrow", "parquet", "output")
    buffer = io.BytesIO()
    writer.write_table(arrow.table(columns), buffer)
    return buffer.getvalue()
