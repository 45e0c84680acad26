"""Trust rules for foreign configurations: classes that a run folder may build.

A run folder is shared between people, so its config.yaml could name any importable callable. Only classes of
this library are built, and classes that installed packages declare in the entry-point group `ahnn.trusted`.
Everything else requires the user's consent, `--trust`.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from hydra.utils import get_object

from ahnn.errors import UserError

LINK = re.compile(r"\$\{measurement(\.\w+)+\}")
"""The only interpolations that are stored: references of a plugin to the group `measurement`."""
MEASURES = (("locate", "__call__"), ("residual", "__call__"))
NEEDED = {
    "system": (("energy", "initial_states"), ("recipe", "steps", "read")),
    "plugins": (("check", "__call__"), ("start", "predict", "update", "run"), *MEASURES),
    "measurement": MEASURES,
    "data": MEASURES,
}
"""Attributes that a class to be built for a node must have: all those in one of the rows."""


def require_trusted(path: Path, content: dict[str, Any], nodes: tuple[str, ...]) -> None:
    """Check all targets and interpolations of configuration nodes.

    Raises:
        UserError: a target that is not trusted, or an interpolation that reads more than the configuration.
    """
    suspicious = []
    for node in nodes:
        for name, value in flat(content.get(node), node):
            role = "system" if name.endswith(".beside._target_") else node  # `beside` of a plugin is a system
            inner = node == "system" and name.count(".") > 1  # a system consists of plain values
            if (
                (isinstance(value, str) and "${" in value and not LINK.fullmatch(value))
                or (isinstance(value, str) and not value.isprintable())
                or (inner and name.endswith("._target_"))
                or (name.endswith("._target_") and not is_trusted(value, role))
                or name.rpartition(".")[2] in ("_partial_", "_args_", "_recursive_", "_convert_")
            ):
                suspicious.append(f"{name}: {value}")
    if suspicious:
        message = (
            f"{path}: expected only classes of ahnn or of installed packages registered with it; received "
            f"{'; '.join(suspicious)}. If you trust the author of this file, add --trust"
        )
        raise UserError(message)


def is_trusted(target: Any, node: str) -> bool:
    """Return whether a class may be built for a node of a configuration from elsewhere."""
    packages = {"ahnn", *(point.value.partition(":")[0] for point in entry_points(group="ahnn.trusted"))}
    if not isinstance(target, str) or target.partition(".")[0] not in packages:
        return False
    try:
        found = get_object(target)
    except Exception:  # a class that cannot be imported is not trusted
        return False
    if not inspect.isclass(found) or found.__module__.partition(".")[0] not in packages:
        return False
    members = {name for base in found.__mro__ for name in vars(base)}
    return any(members.issuperset(names) for names in NEEDED.get(node, ()))


def flat(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield every leaf of nested values with its dotted name."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from flat(item, f"{name}.{key}")
    elif isinstance(value, list):
        for item in value:
            yield from flat(item, name)
    else:
        yield name, value


def targets(value: Any) -> Iterator[Any]:
    """Yield the targets in nested values."""
    return (leaf for name, leaf in flat(value, "") if name.endswith("._target_"))
