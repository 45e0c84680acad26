"""Export of learned dynamics as graphs: torch.export and ONNX, with metadata."""

from __future__ import annotations

from ahnn.graphs.folder import write_export

__all__ = ["write_export"]
