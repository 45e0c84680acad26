"""State of a recursive estimator on disk: restored bit for bit, in a file that never executes anything."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from ahnn.contents import require_regular
from ahnn.estimation.belief import Belief
from ahnn.estimation.state import FilterState, detached
from ahnn.files import write_cached

FORMAT = "ahnn filter state 1"
"""Raise the number when the meaning of a stored tensor changes."""


def save_state(state: FilterState, path: Path | str, notes: Mapping[str, str] | None = None) -> None:
    """Write a state; the file appears whole or not at all. Gradients are not kept.

    Args:
        state: what is written.
        path: of the file.
        notes: texts that are kept beside it, for `load_notes`.
    """
    parts = _named(detached(state))
    orders = {name: _order(part) for name, part in parts.items()}
    content = {name: part.permute(orders[name]).contiguous().clone() for name, part in parts.items()}
    write_cached(Path(path), save(content, {**(notes or {}), "format": FORMAT, "orders": json.dumps(orders)}))


def load_state(path: Path | str, device: torch.device | str = "cpu") -> FilterState:
    """Return a state that `save_state` wrote.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is damaged, or no state.
    """
    try:
        require_regular(Path(path))
        with safe_open(path, framework="pt", device=str(device)) as file:
            metadata = file.metadata() or {}
            if metadata.get("format") != FORMAT:
                raise KeyError(FORMAT)  # noqa: TRY301 - one message for all that is no state
            orders = json.loads(metadata["orders"])
            parts = {
                name: file.get_tensor(name).permute([order.index(i) for i in range(len(order))])
                for name, order in orders.items()
            }
        belief = Belief(parts.pop("mean"), parts.pop("chol"))
        return FilterState(belief=belief, **parts)
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        message = f"path: expected a file written by save_state; received {path} ({error})"
        raise ValueError(message) from error


def load_notes(path: Path | str) -> dict[str, str]:
    """Return the texts beside a state that `load_state` reads."""
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    return {name: text for name, text in metadata.items() if name not in ("format", "orders")}


def _named(state: FilterState) -> dict[str, Tensor]:
    """Return the tensors of a state under their names."""
    parts = state._asdict()
    return {**parts.pop("belief")._asdict(), **parts}


def _order(tensor: Tensor) -> list[int]:
    """Return the axes from the slowest to the fastest in memory.

    Restored tensors lie in memory as they did: a matrix product may round differently where they do not.
    """
    return sorted(range(tensor.ndim), key=lambda axis: -tensor.stride(axis))
