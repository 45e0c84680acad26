"""Atomic checkpoint writing: temporary file in the same folder, flush, rename."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import torch
from lightning.fabric.plugins import TorchCheckpointIO

from ahnn.files import write_atomically


class AtomicCheckpointIO(TorchCheckpointIO):
    """Replacement of Lightning's class, which moves files from TMPDIR, possibly on another file system."""

    def save_checkpoint(
        self, checkpoint: dict[str, Any], path: str | Path, storage_options: Any | None = None
    ) -> None:
        """Write a checkpoint; a previous one at `path` survives any failure."""
        buffer = io.BytesIO()
        torch.save(checkpoint, buffer)
        write_atomically(Path(path), buffer.getvalue())
