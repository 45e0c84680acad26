"""Output of predicted trajectories as predictions.safetensors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import final

from safetensors.torch import save

from ahnn.evaluation.case import Findings
from ahnn.evaluation.results import Results
from ahnn.files import write_atomically
from ahnn.manifest import remove_own


@final
@dataclass(frozen=True)
class PredictionSink:
    """Writes the arrays of an evaluation, or removes the arrays of an earlier one.

    Attributes:
        folder: folder of the evaluation.
        keep: whether to write the arrays.
    """

    folder: Path
    keep: bool = True

    def __call__(self, results: Results, findings: Findings) -> None:
        """Write truth, times, predictions and the arrays of plugins, float64."""
        path = self.folder / "predictions.safetensors"
        if not self.keep:
            remove_own(path)
            return
        arrays = {key: value.contiguous() for key, value in findings.arrays.items()}
        write_atomically(path, save(arrays, {"system": results.space.name, "model": results.label}))
