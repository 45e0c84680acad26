"""Journal of the closing stage: results of its long computations, reused when a run is resumed.

The closing stage is deterministic. After an interruption it starts again and reads each result that is in the
journal instead of computing it: the weights are then equal, and the covariance is equal up to rounding.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from pathlib import Path

import torch
from torch import Tensor

from ahnn.checkpoints import Weights, read_safetensors, write_weights
from ahnn.manifest import remove_own
from ahnn.progress import note

_current: ContextVar[ClosingJournal | None] = ContextVar("journal", default=None)


class ClosingJournal:
    """Results in the order of their computation, one file each.

    Args:
        folder: folder of the files.
        of: checksum of the weights with which the stage begins; results for other weights are replaced.
    """

    def __init__(self, folder: Path, of: str) -> None:
        self.folder, self.of, self.count = folder, of, 0

    @contextlib.contextmanager
    def active(self) -> Iterator[None]:
        """Let `kept` use this journal."""
        token = _current.set(self)
        try:
            yield
        finally:
            _current.reset(token)

    def result(self, name: str, compute: Callable[[], dict[str, Tensor]]) -> dict[str, Tensor]:
        """Return the next result, from its file if it was computed before.

        Raises:
            UserError: the file is damaged.
        """
        path, about = self.folder / f"{self.count:03d}.safetensors", {"of": self.of, "name": name}
        self.count += 1
        if path.exists():
            found = read_safetensors(path, "closing stage")
            if found.about == about:
                return laid_out(found.state)
        state = laid_out(compute())
        write_weights(path, Weights(state, about))
        return state

    def remove(self) -> None:
        """Remove the files, and the folder if nothing else is in it."""
        for path in sorted(self.folder.glob("*.safetensors")):
            remove_own(path)
        with contextlib.suppress(OSError):
            self.folder.rmdir()


def laid_out(state: dict[str, Tensor]) -> dict[str, Tensor]:
    """Return copies in one memory layout: rounding in matrix products depends on strides and alignment."""
    return {name: tensor.clone(memory_format=torch.contiguous_format) for name, tensor in state.items()}


def kept(name: str, compute: Callable[[], dict[str, Tensor]]) -> dict[str, Tensor]:
    """Return the tensors of a long computation; an active journal stores and reuses them."""
    note(name)
    journal = _current.get()
    return compute() if journal is None else journal.result(name, compute)


def is_active() -> bool:
    """Return whether a journal is active."""
    return _current.get() is not None
