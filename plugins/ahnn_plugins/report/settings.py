"""Configuration of a run folder as plain values and text, without building anything."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

from ahnn.contents import read_plain, read_whole
from ahnn.errors import UserError

SETTINGS = "config.yaml"


def text_of(folder: Path) -> str:
    """Return the configuration of a run, or of an evaluation's run; "" if missing."""
    for place in (folder, folder.parent.parent):
        with suppress(OSError):
            return read_whole(place / SETTINGS).decode("utf-8", "replace")
    return ""


def values_of(folder: Path) -> dict[str, Any]:
    """Return the configuration of a run as nested values; empty if unreadable."""
    for place in (folder, folder.parent.parent):
        with suppress(UserError):
            return read_plain(place / SETTINGS)
    return {}


def noise_of(content: dict[str, Any]) -> str:
    """Return the configured noise of the training data; `exact` if there is none."""
    data = content.get("data")
    noise = data.get("noise") if isinstance(data, dict) else None
    return "exact" if noise is None else str(noise)[:60]


def data_of(content: dict[str, Any]) -> tuple[str, ...]:
    """Return the paths of the data files of a training; empty for a system with known equations."""
    system = content.get("system")
    path = system.get("path") if isinstance(system, dict) else None
    return tuple(map(str, path)) if isinstance(path, list) else () if path is None else (str(path),)


def loss_of(content: dict[str, Any]) -> str:
    """Describe the training loss in a few words; "" if not configured."""
    loss = content.get("loss")
    if not isinstance(loss, dict):
        return ""
    if isinstance(stages := loss.get("stages"), list):
        return "weak form" if "weak" in str(stages) else "shooting"
    fraction = loss.get("derivative")
    if not isinstance(fraction, int | float) or fraction == 0:
        return "recursive"
    return "derivatives" if fraction == 1 else f"derivatives, then recursive ({fraction:g})"
