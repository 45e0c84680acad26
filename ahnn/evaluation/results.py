"""Results of an evaluation, and their versioned file metrics.json."""

from __future__ import annotations

import html
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from ahnn.arguments import check_values
from ahnn.contents import read_json
from ahnn.errors import UserError
from ahnn.evaluation.case import Row, Who
from ahnn.evaluation.titles import title
from ahnn.files import write_atomically
from ahnn.metrics import Scores
from ahnn.types import Space, Units

T = TypeVar("T")

SCHEMA = 2
"""Schema version, increased when the meaning of a key of metrics.json changes."""

FILE = "metrics.json"
NOT_FINITE = {"inf": math.inf, "-inf": -math.inf, "nan": math.nan}
"""Strings that replace numbers not allowed in strict JSON."""


class Results(NamedTuple):
    """Results of an evaluation, without arrays and figures.

    Attributes:
        label: name of the model in tables.
        assumes: prior knowledge of the dynamics assumed by the model.
        space: description of the state components.
        rows: scores, with the identity of each row.
        training: training information, such as `seed`, `window`, `val_loss` and `seconds`.
        numbers: additional numbers of each plugin, by plugin name.
        about: versions, command, machine and date; see `provenance`.
        schema: version of the file.
    """

    label: str
    assumes: str
    space: Space
    rows: tuple[Row, ...]
    training: dict[str, Any] = {}  # noqa: RUF012 - never written to
    numbers: dict[str, Any] = {}  # noqa: RUF012
    about: dict[str, Any] = {}  # noqa: RUF012
    schema: int = SCHEMA

    def row(self, who: Who) -> Row | None:
        """Return the row with a given identity, or None."""
        return next((row for row in self.rows if row.who == who), None)

    @property
    def verdict(self) -> tuple[str, ...]:
        """Findings of the verdict, its judgement first; none in the results of older versions."""
        stated = self.numbers.get("verdict")
        found = stated.get("findings") if isinstance(stated, Mapping) else None
        return tuple(map(str, found)) if isinstance(found, list) else ()

    def __str__(self) -> str:
        from ahnn.evaluation.score_table import results_table

        return results_table(self)

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(str(self))}</pre>"


def load_results(folder: Path | str) -> Results:
    """Load the results from a folder's metrics.json.

    Raises:
        UserError: the file is missing or damaged, or has a different schema.
    """
    path = Path(folder) / FILE
    content = read_json(path)
    schema = content.get("schema", "none")
    try:
        results = decoded(content) if schema == SCHEMA else None
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        reason = f"no {error}" if isinstance(error, KeyError) else error
        message = f"{path}: expected the results of an evaluation; received a damaged file: {reason}"
        raise UserError(message) from error
    if results is None:
        message = f"{path}: expected schema {SCHEMA}; received {schema}. Evaluate the run again"
        raise UserError(message)
    return results


def write_results(folder: Path, results: Results) -> None:
    """Write metrics.json as strict JSON into a folder; `load_results` reads it."""
    text = json.dumps(encoded(results), indent=2, allow_nan=False)
    write_atomically(folder / FILE, text.encode())


def encoded(results: Results) -> dict[str, Any]:
    """Return results as plain values for strict JSON.

    The `name` of a row is for human readers only and follows from its identity.
    """
    space = results.space
    content = {
        "schema": results.schema,
        "system": space.name,
        "model": results.label,
        "assumes": results.assumes,
        "training": results.training,
        "units": space.units._asdict(),
        "components": space.components,
        "inertia": space.inertia,
        "frame": space.frame,
        "mechanical": space.mechanical,
        "rows": [
            {"name": title(r.who, results.label), **r.who._asdict(), **r.scores._asdict()}
            | {"note": r.note, "extra": r.extra}
            for r in results.rows
        ],
        "plugins": results.numbers,
        "about": results.about,
    }
    return plain(content)


def decoded(content: Mapping[str, Any]) -> Results:
    """Rebuild results from the output of `encoded`; raises KeyError, TypeError, AttributeError or UserError.

    Except in texts such as labels and notes, the strings inf, -inf and nan become numbers.
    """
    space = {
        "name": content["system"],
        "components": content["components"],
        "units": _built(Units, content["units"]),
        "inertia": restored(content["inertia"]),
    }
    later = ("frame", "mechanical")  # absent in earlier versions
    space |= {name: content[name] for name in later if name in content}
    results = {
        "label": content["model"],
        "assumes": content["assumes"],
        "space": _built(Space, space),
        "rows": [_row(row) for row in content["rows"]],
        "training": restored(content["training"]),
        "numbers": restored(content["plugins"]),
        "about": restored(content["about"]),
        "schema": content["schema"],
    }
    return _built(Results, results)


def _row(row: Mapping[str, Any]) -> Row:
    who = _built(Who, {name: row[name] for name in Who._fields})
    scores = _built(Scores, {name: restored(row[name]) for name in Scores._fields})
    return _built(Row, {"who": who, "scores": scores, "note": row["note"], "extra": restored(row["extra"])})


def _built(kind: Callable[..., T], fields: Mapping[str, Any]) -> T:
    """Return a named tuple of fields that fit its annotations, with lists as tuples."""
    if any(isinstance(value, Mapping) and "_target_" in value for value in fields.values()):
        message = "a key _target_"  # `check_values` accepts such a mapping for any type
        raise ValueError(message)
    check_values("", kind, fields)
    return kind(**{key: tuple(value) if isinstance(value, list) else value for key, value in fields.items()})


def plain(value: Any) -> Any:
    """Return nested values for strict JSON: non-finite numbers become strings."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(float(value))
    if value is None or isinstance(value, str | bool | int | float):
        return value
    return plain(value.tolist()) if hasattr(value, "tolist") else str(value)


def restored(value: Any) -> Any:
    """Return nested values with strings from `plain` converted back to numbers."""
    if isinstance(value, dict):
        return {key: restored(item) for key, item in value.items()}
    if isinstance(value, list):
        return [restored(item) for item in value]
    return NOT_FINITE.get(value, value) if isinstance(value, str) else value
