"""Output of results as metrics.json."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import final

from ahnn.evaluation.case import Findings
from ahnn.evaluation.results import FILE, Results, encoded
from ahnn.files import write_atomically


@final
@dataclass(frozen=True)
class MetricsSink:
    """Writes metrics.json, which `load_results` reads.

    Attributes:
        folder: folder of the evaluation.
    """

    folder: Path

    def __call__(self, results: Results, findings: Findings) -> None:  # noqa: ARG002
        """Write the results as strict JSON."""
        text = json.dumps(encoded(results), indent=2, allow_nan=False)
        write_atomically(self.folder / FILE, text.encode())
