"""Equations of a run's system from its configuration, restricted to systems of this library."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

from ahnn import systems
from ahnn.contents import read_plain
from ahnn.errors import UserError
from ahnn.systems import System
from ahnn_plugins.report.collection import Entry
from ahnn_plugins.report.figures.models import training_folder

KNOWN: dict[str, type[System]] = {
    f"ahnn.systems.{name}": each
    for name, each in vars(systems).items()
    if inspect.isclass(each) and issubclass(each, System) and not inspect.isabstract(each)
}


def system_of(entry: Entry) -> System | None:
    """Return the system of a run; None unless configured as a system of this library.

    Run folders are untrusted: the YAML is read as plain values, the class must be in `KNOWN`, and no named
    file is opened. A system inconsistent with the results gives None.
    """
    own, run = (folder / "config.yaml" for folder in (entry.folder, training_folder(entry)))
    options = _options(own if own.is_file() else run)
    kind = KNOWN.get(str(options.pop("_target_", "")))
    if kind is None or (kind is systems.MolniyaGravity and options.get("gravity", "ggm05c") != "ggm05c"):
        return None
    try:
        system = kind(**options)
        same = system.space._replace(frame="") == entry.results.space._replace(frame="")
    except (UserError, TypeError, ValueError):
        return None
    return system if same else None


def _options(path: Path) -> dict[str, Any]:
    """Return the system options of a configuration; empty if missing or not YAML."""
    try:
        node = read_plain(path).get("system")
    except UserError:
        return {}
    if not isinstance(node, dict) or not all(_is_plain(value) for value in node.values()):
        return {}
    return node


def _is_plain(value: Any) -> bool:
    """Return whether a value is one number or text, or a list of them; deeper nesting could be unbounded."""
    items = value if isinstance(value, list) else [value]
    return all(item is None or isinstance(item, str | bool | int | float) for item in items)
