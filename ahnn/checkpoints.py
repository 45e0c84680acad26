"""Reading checkpoints without unpickling anything, and comparing them with what is asked for."""

from __future__ import annotations

import pickle
import zipfile
from pathlib import Path
from typing import Any

import torch

from ahnn.errors import UserError


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Return the content of a Lightning checkpoint, tensors and plain values only.

    Raises:
        UserError: the file is missing or damaged, or holds anything that would have to be executed.
    """
    if not path.is_file():
        message = f"checkpoint {path}: expected a file; found none. Name the run folder: run=DIR ckpt=last"
        raise UserError(message)
    try:
        require_intact(path)
        content = torch.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:  # torch's own message tells how to execute it
        message = (
            f"checkpoint {path}: expected tensors and plain values; received objects that only executing the "
            "file would restore, which ahnn never does. Train again, or take a checkpoint written by ahnn"
        )
        raise UserError(message) from error
    except Exception as error:  # torch and zipfile raise many types for a damaged file
        reason = next(iter(str(error).strip().splitlines()), type(error).__name__)
        message = (
            f"checkpoint {path}: expected an intact checkpoint of ahnn; received a damaged file ({reason}). "
            "Take another one, or train again"
        )
        raise UserError(message) from error
    if not isinstance(content, dict) or "state_dict" not in content or "ahnn" not in content:
        message = f"checkpoint {path}: expected a checkpoint written by ahnn; received something else"
        raise UserError(message)
    return content


def require_intact(path: Path) -> None:
    """Compare every record of a checkpoint with its checksum, which torch does not do.

    Raises:
        zipfile.BadZipFile: a record is not what was written, or the file is none that `torch.save` writes.
    """
    with zipfile.ZipFile(path) as archive:
        damaged = archive.testzip()
    if damaged is not None:
        message = f"record {damaged} does not fit its checksum"
        raise zipfile.BadZipFile(message)


def require_same(who: str, expected: dict[str, Any], received: dict[str, Any]) -> None:
    """Compare nested plain values.

    Raises:
        UserError: they differ; the message lists every key that does.
    """
    wanted, found = flatten(expected), flatten(received)
    rows = [
        f"  {key}: expected {wanted.get(key, 'nothing')}, received {found.get(key, 'nothing')}"
        for key in sorted(wanted.keys() | found.keys())
        if wanted.get(key) != found.get(key)
    ]
    if rows:
        message = f"{who}: it belongs to another training:\n" + "\n".join(rows)
        raise UserError(message)


def flatten(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested plain values under dotted keys; lists and tuples compare alike."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, dict):
            flat |= flatten(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = list(value) if isinstance(value, tuple) else value
    return flat
