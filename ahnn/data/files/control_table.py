"""Reading of control tables: a time column and one column per control."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from ahnn.controls import ControlTable
from ahnn.data.files import kinds, sidecar
from ahnn.data.files.columns import TIMES, control_named
from ahnn.data.files.reading import bytes_of, table_of
from ahnn.data.files.samples import Array
from ahnn.data.files.table import Place, Remark, Sheet, refuse
from ahnn.data.files.tabular import numbers
from ahnn.data.files.units import factor
from ahnn.errors import UserError
from ahnn.types import Space


def read_controls(path: Path, space: Space) -> ControlTable:
    """Read the controls in a file, by the control names of the space.

    Args:
        path: path of a table, CSV or Parquet; its sidecar may contain `controls: linear`.
        space: names of the controls, and the unit of time.

    Raises:
        UserError: not a table, a missing column, or times that do not increase.
    """
    if not path.is_file():
        reason = "not a regular file" if path.exists() else "No such file"
        message = f"controls: expected numbers or a file; received {path}: {reason}"
        raise UserError(message)
    raw, aside = bytes_of(path)
    kind = kinds.kind_of(raw, str(path))
    if kind not in kinds.TABLES:
        Place(str(path)).refuse(f"a table with time and {', '.join(space.controls)}", kind)
    sheet, said = table_of(path, raw, aside, kind)
    if said.columns or said.frame:
        place = Place(str(sidecar.beside(path)))
        place.refuse("only units and controls in the sidecar of a control file", "columns or frame")
    times, unit = _times(sheet, space)
    names = [control_named(name, space.controls) for name in sheet.header.names]
    if not len(sheet.rows):
        sheet.place.refuse("a row for each change of a control", "only a header")
    for name in space.controls:
        if names.count(name) != 1:
            expected = f"the control columns {', '.join(space.controls)}"
            sheet.place.refuse(expected, ", ".join(sheet.header.names))
    if others := [name for name in names if name not in (unit, *space.controls)]:
        refuse(
            Remark(
                sheet.place, f"not used, since they are not controls: {', '.join(others)}", level="warning"
            )
        )
    units = {name: sheet.header.units[names.index(name)] for name in space.controls}
    if given := [f"{name} [{unit}]" for name, unit in units.items() if unit]:
        what = f"not converted, but assumed to be in the units of the training data: {', '.join(given)}"
        refuse(Remark(sheet.place, what, level="warning"))
    columns = [_column(sheet, names.index(name)) for name in space.controls]
    values = torch.from_numpy(np.stack(columns, axis=1))
    return ControlTable(torch.from_numpy(times), values, said.controls == sidecar.LINEAR)


def _times(sheet: Sheet, space: Space) -> tuple[Array, str]:
    """Return the times in the unit of a space, and the name of their column."""
    names, place = sheet.header.names, sheet.place
    found = [k for k, name in enumerate(names) if name.lower() in TIMES]
    if len(found) != 1:
        place.refuse(f"one column named {' or '.join(TIMES)}", ", ".join(names))
    name, given = names[found[0]], sheet.header.units[found[0]]
    times = _column(sheet, found[0])
    if given is not None:
        try:
            times = times * factor(given, space.units.time)
        except ValueError:
            expected = f"a unit compatible with {space.units.time}"
            place._replace(column=name).refuse(expected, given)
    late = np.flatnonzero(~(np.diff(times) > 0))
    if len(late):
        row = int(sheet.rows[late[0] + 1])
        Place(place.file, row, name).refuse("increasing times", f"{times[late[0] + 1]:g}")
    return times, name


def _column(sheet: Sheet, column: int) -> Array:
    """Return the numbers of a column; raises UserError for missing values."""
    values = numbers(sheet, column, refuse)
    for k in np.flatnonzero(np.isnan(values)):
        where = Place(sheet.place.file, int(sheet.rows[k]), sheet.header.names[column])
        where.refuse("a number in each row", "none", "Repeat the value that is held")
    return values
