"""Exact saving of recursive estimator states in a file without executable content.

A state is a NamedTuple of tensors and of NamedTuples of tensors, stored under their field names. One checksum
protects tensors and texts, as in files of weights; tensors are also checked against the limits of a state.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

import torch
from torch import Tensor

from ahnn.checkpoints import Weights, packed, read_safetensors
from ahnn.errors import UserError
from ahnn.estimation.belief import Belief, Status
from ahnn.estimation.estimator import EstimatorState
from ahnn.estimation.state import FilterState
from ahnn.files import write_state

S = TypeVar("S", bound=EstimatorState)

FORMAT = "ahnn filter state 2"
"""Version number, increased when the meaning of a stored tensor changes. Format 1 had no checksum."""


class SavedPart(NamedTuple):
    """Requirements on a tensor of a state, which must also be finite.

    Attributes:
        axes: B for members, D for components.
        dtype: required dtype.
        least, most: inclusive limits of each number.
    """

    axes: str
    dtype: torch.dtype
    least: float = -math.inf
    most: float = math.inf


PARTS = {
    "mean": SavedPart("BD", torch.float64),
    "chol": SavedPart("BDD", torch.float64),
    "time": SavedPart("", torch.float64),
    "steps": SavedPart("", torch.int64, 0),
    "status": SavedPart("B", torch.int64, 0, max(Status)),
    "failed_step": SavedPart("B", torch.int64, -1),
    "rejections": SavedPart("B", torch.int64, 0),
    "repairs": SavedPart("B", torch.int64, 0),
    "log_likelihood": SavedPart("B", torch.float64),
}


def save_state(state: EstimatorState, path: Path | str, notes: Mapping[str, str] | None = None) -> None:
    """Write a state atomically; gradients are not saved.

    Args:
        state: state to be saved.
        path: path of the file.
        notes: additional texts, for `load_notes`.

    Raises:
        ValueError: an invalid state, which `load_state` would reject.
    """
    parts = {name: part.detach() for name, part in _named(state).items()}
    _check(parts, state)
    orders = {name: _order(part) for name, part in parts.items()}
    content = {name: part.cpu().permute(orders[name]).contiguous().clone() for name, part in parts.items()}
    about = {"format": FORMAT, "orders": orders, "notes": dict(notes or {})}
    write_state(Path(path), packed(Weights(content, about)))


def load_state(path: Path | str, device: torch.device | str = "cpu", *, like: S | None = None) -> S:
    """Load a state written by `save_state`.

    Args:
        path: path of the file.
        device: device of the tensors.
        like: a state of the same estimator, as a template; None for a `FilterState`.

    Raises:
        FileNotFoundError: the file is missing.
        ValueError: the file is damaged, has a different format, or does not contain a state of this kind.
    """
    stored, about = _read(Path(path))
    try:
        orders = about["orders"]
        parts = {
            name: part.to(device).permute([orders[name].index(i) for i in range(part.ndim)])
            for name, part in stored.items()
        }
        _check(parts, like)
    except (KeyError, TypeError, ValueError, RuntimeError, AttributeError) as error:
        raise ValueError(_refusal(path, error)) from error
    if like is not None:
        return _filled(like, parts)
    belief = Belief(parts.pop("mean"), parts.pop("chol"))
    return cast(S, FilterState(belief=belief, **parts))


def load_notes(path: Path | str) -> dict[str, str]:
    """Load the texts saved with a state; raises the same errors as `load_state`."""
    return _read(Path(path)).about["notes"]


def _read(path: Path) -> Weights:
    """Read a file of this format and verify its checksum.

    Raises:
        FileNotFoundError: the file is missing.
        ValueError: the file is damaged, or has a different format.
    """
    if not path.exists():
        raise FileNotFoundError(path)
    if not path.is_file():
        raise ValueError(_refusal(path, "no file"))
    try:
        content = read_safetensors(path, "state")
    except UserError as error:
        raise ValueError(_refusal(path, "damaged")) from error
    if content.about.get("format") != FORMAT:
        raise ValueError(_refusal(path, "another format"))
    return content


def _refusal(path: Path | str, reason: object) -> str:
    return (
        f"path: expected a file written by save_state, of this version; received {path} ({reason}). "
        "Start over with another state"
    )


def _check(parts: dict[str, Any], like: EstimatorState | None) -> None:
    """Raise ValueError for the first tensor that is invalid in a state."""
    known = PARTS if like is None or isinstance(like, FilterState) else _named(like)
    if parts.keys() != known.keys():
        message = f"expected {', '.join(known)}; received {', '.join(parts)}"
        raise ValueError(message)
    if known is not PARTS:
        _compare(parts, known)
        return
    sizes = dict(zip("BD", parts["mean"].shape, strict=True))
    for name, (axes, dtype, least, most) in PARTS.items():
        part, shape = parts[name], tuple(sizes[axis] for axis in axes)
        right = part.dtype == dtype and tuple(part.shape) == shape and bool(part.isfinite().all())
        if not right or bool(((part < least) | (part > most)).any()):
            message = (
                f"{name}: expected finite {dtype} of shape {shape}, from {least:g} to {most:g}; received "
                f"{part.dtype} {tuple(part.shape)}, or values out of range"
            )
            raise ValueError(message)


def _compare(parts: dict[str, Tensor], known: Mapping[str, Any]) -> None:
    """Raise ValueError for tensors whose type or shape differs from the template state."""
    for name, part in parts.items():
        if (part.dtype, part.shape) != (known[name].dtype, known[name].shape):
            expected = f"{known[name].dtype} {tuple(known[name].shape)}"
            message = f"{name}: expected {expected}; received {part.dtype} {tuple(part.shape)}"
            raise ValueError(message)


def _named(state: Any) -> dict[str, Tensor]:
    """Return the tensors of a state by field name; nested tuples contribute their own field names."""
    named: dict[str, Tensor] = {}
    for name, part in state._asdict().items():
        inner = _named(part) if isinstance(part, tuple) else {name: part}
        if twice := named.keys() & inner.keys():
            message = f"state: expected parts with different names; received {', '.join(sorted(twice))} twice"
            raise ValueError(message)
        named |= inner
    return named


def _filled(like: S, parts: Mapping[str, Tensor]) -> S:
    """Return a state with its tensors replaced."""
    fields = cast(Any, like)._asdict().items()
    filled = {k: _filled(cast(Any, p), parts) if isinstance(p, tuple) else parts[k] for k, p in fields}
    return like._replace(**filled)


def _order(tensor: Tensor) -> list[int]:
    """Return the axes from the slowest to the fastest in memory.

    Restored tensors keep their memory layout, since a matrix product may round differently otherwise.
    """
    return sorted(range(tensor.ndim), key=lambda axis: -tensor.stride(axis))
