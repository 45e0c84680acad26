"""Learned dynamics as graphs that other programs run: torch.export and ONNX, and what their numbers mean."""

from __future__ import annotations

from ahnn.graphs.folder import write_export

__all__ = ["write_export"]
