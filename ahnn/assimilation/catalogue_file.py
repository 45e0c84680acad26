"""File of a catalogue's beliefs and reading windows, restored bit-identically and without unpickling."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ahnn.assimilation.object_windows import FollowedObjects, KeptRow, ObjectWindow
from ahnn.assimilation.stream_identity import refusal
from ahnn.checkpoints import Weights, packed, read_safetensors
from ahnn.errors import UserError
from ahnn.estimation import Belief, FilterState, Status
from ahnn.estimation.member_steps import member_rows
from ahnn.files import write_state

FORMAT = "ahnn catalogue 1"
"""Version number, increased when the meaning of a stored tensor changes."""
BELIEFS = ("status", "failed_step", "rejections", "repairs", "log_likelihood")
"""Fields of a state besides mean and factor."""
OTHERS = "Repeat the original command, or remove the state and its output to start over"


def write_catalogue(objects: FollowedObjects, path: Path, identity: str, notes: Mapping[str, str]) -> None:
    """Write objects to a file atomically."""
    kept = [*chain.from_iterable(objects.windows)]
    slots = np.array([one.slot for one in kept], dtype=np.int64)
    used, places = np.unique(slots, return_inverse=True)
    state = member_rows(objects.state, torch.from_numpy(used))
    width = max((len(one.values) for one in kept if one.values is not None), default=0)
    nothing = [np.nan] * width
    columns = {
        "counts": np.array([len(window) for window in objects.windows], dtype=np.int64),
        "slots": places.astype(np.int64).reshape(-1),
        "times": np.array([one.time for one in kept], dtype=np.float64),
        "sensors": np.array([one.sensor for one in kept], dtype=np.int64),
        "there": np.array([one.values is not None for one in kept], dtype=np.int64),
        "values": np.array([one.values or nothing for one in kept]).reshape(len(kept), width),
        "deviations": np.array([one.deviations or nothing for one in kept]).reshape(len(kept), width),
        "since": objects.since,
        "lost": objects.lost,
    }
    content = {name: torch.from_numpy(column) for name, column in columns.items()}
    content |= {"mean": state.belief.mean, "chol": state.belief.chol}
    content |= {name: getattr(state, name) for name in BELIEFS}
    about = {"format": FORMAT, "of": identity, "names": [*objects.names], "notes": dict(notes)}
    write_state(path, packed(Weights(content, about)))


def read_catalogue(
    objects: FollowedObjects, path: Path, identity: str, names: list[str] | None, width: int
) -> dict[str, str]:
    """Restore objects from a file, and return its notes.

    Args:
        objects: container to fill, once the file has been read completely.
        path: path of the file.
        identity: identity of the filters' settings.
        names: names of the objects; None if unknown in advance.
        width: number W of columns.

    Raises:
        UserError: a missing or damaged file, or one of other filters or objects.
    """
    try:
        content, about = read_safetensors(path, "state")
        if about.get("format") != FORMAT:
            message = "another format"
            raise ValueError(message)  # noqa: TRY301 - one message for every kind of damage
        state = _state(content, objects.state)
        restored = _windows(content, len(state.status), width)
        parts = [content[name].numpy() for name in ("since", "lost")]
        count = len(about["names"])
        if len(restored) != count or any(part.shape != (count,) for part in parts):
            message = "unequal numbers of objects"
            raise ValueError(message)  # noqa: TRY301
        notes = {str(key): str(value) for key, value in about["notes"].items()}
    except (UserError, OSError, ValueError, KeyError, TypeError, RuntimeError, AttributeError) as error:
        message = f"state: expected a file written by save; received {path} ({error})"
        raise UserError(message) from error
    if about["of"] != identity:
        raise UserError(refusal(path, about["of"], identity))
    if names is not None and names != about["names"]:
        message = f"start: expected the {count} objects of {path}; received different objects. {OTHERS}"
        raise UserError(message)
    objects.restore(about["names"], state, restored, *parts)
    return notes


def _state(content: dict[str, Tensor], like: FilterState) -> FilterState:
    """Return the rows of a state; raises ValueError for invalid beliefs."""
    parts: dict[str, Any] = {name: content[name] for name in BELIEFS}
    belief = Belief(content["mean"], content["chol"])
    count, size = len(belief.mean), like.belief.mean.shape[-1]
    right = belief.mean.shape == (count, size) and belief.chol.shape == (count, size, size)
    right = right and all(part.shape == (count,) for part in parts.values())
    right = right and all(parts[name].dtype == getattr(like, name).dtype for name in BELIEFS)
    right = right and all(part.dtype == torch.float64 and bool(part.isfinite().all()) for part in belief)
    if not right or bool((parts["status"] != 0).any()):
        message = "no beliefs"
        raise ValueError(message)
    return like._replace(belief=belief, **parts)


def _windows(content: dict[str, Tensor], rows: int, width: int) -> list[ObjectWindow]:
    """Return the reading windows of objects; raises ValueError for invalid content."""
    names = ("times", "slots", "sensors", "there", "values", "deviations")
    columns = [content[name].tolist() for name in names]
    counts, slots = content["counts"], content["slots"]
    whole = len({len(column) for column in columns}) == 1 and int(counts.sum()) == len(slots)
    whole = whole and not bool((counts < 1).any()) and bool(content["times"].isfinite().all())
    lost = content["lost"]
    whole = whole and not bool(((slots < 0) | (slots >= rows)).any())
    whole = whole and not bool(((lost < 0) | (lost > max(Status))).any())
    if not whole or content["values"].shape[1] not in (0, width):
        message = "no windows"
        raise ValueError(message)
    kept = [
        KeptRow(time, slot, sensor, *((values, deviations) if there else (None, None)))
        for time, slot, sensor, there, values, deviations in zip(*columns, strict=True)
    ]
    ends = counts.cumsum(0).tolist()
    return [ObjectWindow(kept[end - count : end]) for end, count in zip(ends, counts.tolist(), strict=True)]
