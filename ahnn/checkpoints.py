"""Checkpoint files: reading weights without unpickling, and checks that they match a model."""

from __future__ import annotations

import hashlib
import io
import json
import pickle
import zipfile
from pathlib import Path
from typing import Any, NamedTuple

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from ahnn.arguments import flatten
from ahnn.contents import require_regular
from ahnn.errors import UserError
from ahnn.files import write_atomically

FORMAT = 2
"""Version of the metadata stored with weights; increase it when their meaning changes."""


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Return the content of a Lightning checkpoint, restricted to tensors and plain values.

    Raises:
        UserError: the file is missing or damaged, or contains code to be executed.
    """
    if path.parent.name == "checkpoints" and not path.parent.exists():
        message = f"run {path.parents[1]}: expected the folder of a training run; received none"
        raise UserError(message)
    if not path.exists() or path.is_dir():
        message = f"checkpoint {path}: expected best, last or a file; received none. Use run=DIR ckpt=last"
        raise UserError(message)
    try:
        require_regular(path)
        require_intact(path)
        content = torch.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:  # torch's own message explains how to execute the content
        message = (
            f"checkpoint {path}: expected tensors and plain values; received objects that only code in the "
            "file could restore, which ahnn never executes. Train again, or use a checkpoint written by ahnn"
        )
        raise UserError(message) from error
    except Exception as error:  # torch and zipfile raise many types for a damaged file
        reason = next(iter(str(error).strip().splitlines()), type(error).__name__)
        message = (
            f"checkpoint {path}: expected an intact ahnn checkpoint; received a damaged file ({reason}). "
            "Use another one, or train again"
        )
        raise UserError(message) from error
    if not (
        isinstance(content, dict)
        and isinstance(content.get("state_dict"), dict)
        and all(isinstance(name, str) for name in content["state_dict"])
        and _is_plain(content.get("ahnn"))
    ):
        message = f"checkpoint {path}: expected a checkpoint written by ahnn; received something else"
        raise UserError(message)
    return content


def as_stored(state: dict[str, Tensor], path: Path) -> dict[str, Tensor]:
    """Return weights in their own dtype, rounded to the dtype in which `replace_weights` stores them."""
    own = read_checkpoint(path)["state_dict"]
    return {key: value.to(own[f"dynamics.{key}"]).to(value) for key, value in state.items()}


def replace_weights(path: Path, state: dict[str, Tensor], about: dict[str, Any]) -> None:
    """Replace the weights and metadata of the dynamics in a Lightning checkpoint."""
    content = read_checkpoint(path)
    own = content["state_dict"]
    own |= {f"dynamics.{key}": value.to(own[f"dynamics.{key}"]) for key, value in state.items()}
    content["ahnn"] |= about
    buffer = io.BytesIO()
    torch.save(content, buffer)
    write_atomically(path, buffer.getvalue())


def _is_plain(about: Any) -> bool:
    """Return whether nested values contain no tensors, which `==` does not compare."""
    try:
        return isinstance(about, dict) and bool(json.dumps(about))
    except (TypeError, ValueError, RecursionError):
        return False


def require_intact(path: Path) -> None:
    """Compare every record of a checkpoint with its checksum, which torch does not do.

    Raises:
        zipfile.BadZipFile: a record is corrupt, or the file is not a `torch.save` archive.
    """
    with zipfile.ZipFile(path) as archive:
        if sum(record.file_size for record in archive.infolist()) > path.stat().st_size:
            message = "records larger than the file"  # compressed or shared records could expand to any size
            raise zipfile.BadZipFile(message)
        damaged = archive.testzip()
    if damaged is not None:
        message = f"record {damaged} does not match its checksum"
        raise zipfile.BadZipFile(message)


class Weights(NamedTuple):
    """Trained weights and their metadata.

    Attributes:
        state: tensors of the dynamics by parameter or buffer name.
        about: plain values: `dynamics` (arguments of `make_dynamics`), `space`, `dt`, and the training data.
    """

    state: dict[str, Tensor]
    about: dict[str, Any]


def read_weights(path: str | Path) -> Weights:
    """Return the weights in a checkpoint or in a safetensors file that `write_weights` wrote.

    Raises:
        UserError: the file is missing, damaged, of an unknown format, or contains tensors that are not real.
    """
    path = Path(path)
    if path.suffix == ".safetensors":
        state, about = read_safetensors(path, "weights")
    else:
        content = read_checkpoint(path)
        prefix = "dynamics."
        state = {k.removeprefix(prefix): v for k, v in content["state_dict"].items() if k.startswith(prefix)}
        about = content["ahnn"]
    if (received := about.get("format", "an earlier one")) != FORMAT:
        message = f"weights {path}: expected format {FORMAT}; received {received}. Train again"
        raise UserError(message)
    if wrong := [name for name, value in state.items() if not _is_dense(value)]:
        message = (
            f"weights {path}: expected tensors of real numbers; received other values for {', '.join(wrong)}"
        )
        raise UserError(message)
    return Weights(state, about)


def _is_dense(value: Any) -> bool:
    """Return whether a value is a real tensor without overlapping memory."""
    if not isinstance(value, Tensor) or value.layout is not torch.strided or value.device.type != "cpu":
        return False
    size = value.numel() * value.element_size()
    real = not (value.is_complex() or value.is_quantized)
    return real and size <= value.untyped_storage().nbytes()


def write_weights(path: Path, weights: Weights) -> None:
    """Write weights as a safetensors file, atomically."""
    write_atomically(path, packed(weights))


def packed(weights: Weights) -> bytes:
    """Return the weights as the bytes of a safetensors file, with a checksum over all content."""
    tensors = {key: value.contiguous() for key, value in weights.state.items()}
    about = json.dumps(weights.about)
    return save(tensors, {"ahnn": about, "sha256": checksum(tensors, about)})


def checksum(tensors: dict[str, Tensor], about: str) -> str:
    """Return the SHA-256 of tensor names, values and metadata."""
    digest = hashlib.sha256(about.encode())
    for name in sorted(tensors):
        digest.update(name.encode())
        if tensors[name].numel():  # torch refuses views of some empty tensors
            content = (
                tensors[name].detach().contiguous().reshape(-1).view(torch.uint8)
            )  # works for every dtype
            digest.update(content.numpy().tobytes())
    return digest.hexdigest()


def read_safetensors(path: Path, who: str) -> Weights:
    """Return tensors and the metadata of ahnn, {} if absent, after verification of the checksum.

    Raises:
        UserError: the file is missing or damaged; the message begins with `who`.
    """
    try:
        require_regular(path)
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            text = metadata.get("ahnn", "{}")
            state = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 - not a dict
        if "ahnn" in metadata and checksum(state, text) != metadata.get("sha256"):
            message = "checksum"
            raise ValueError(message)  # noqa: TRY301 - one message for every kind of damage
        about = json.loads(text)
        if not isinstance(about, dict):
            message = f"{str(about)[:40]!r} instead of a description"
            raise TypeError(message)  # noqa: TRY301
    except (SafetensorError, OSError, ValueError, TypeError, RecursionError) as error:
        message = f"{who} {path}: expected an intact safetensors file; received a damaged one ({error})"
        raise UserError(message) from error
    return Weights(state, about)


def require_same(who: str, expected: dict[str, Any], received: dict[str, Any], remedy: str = "") -> None:
    """Compare nested plain values.

    Args:
        who: owner of the expected values.
        expected: values of the owner.
        received: values that should be the same.
        remedy: last line of the message, which tells the user what to do.

    Raises:
        UserError: the values differ; the message lists every differing key.
    """
    wanted, found = flatten(expected), flatten(received)
    rows = [
        f"  {key}: the content of the files has changed"
        if key.endswith("recipe.files") and key in wanted and key in found
        else f"  {key}: expected {wanted.get(key, 'nothing')}, received {found.get(key, 'nothing')}"
        for key in sorted(wanted.keys() | found.keys())
        if wanted.get(key) != found.get(key)
    ]
    if rows:
        message = "\n".join((f"{who} belongs to a different training run:", *rows, *filter(None, [remedy])))
        raise UserError(message)
