"""Export learned dynamics to other programs: `python -m ahnn.export run=DIR | pretrained=NAME output=FOLDER`.

run=DIR             a run folder
pretrained=NAME     a model shipped with the package
ckpt=best           the weights: best, last, or a path
output=FOLDER       a new folder: flow and energy as .pt2 and .onnx, weights.safetensors, model.json
"""

from __future__ import annotations

from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing


def export(arguments: list[str]) -> None:
    """Export the model named on the command line; raises the same errors as `jobs.exporting`."""
    with importing():
        from ahnn.cli.pairs import read_pairs
        from ahnn.jobs import exporting

    exporting.export(read_pairs(arguments, exporting.ExportRequest))


def main() -> None:
    """Entry point of `python -m ahnn.export` and `ahnn-export`."""
    run_command(export, __doc__)


if __name__ == "__main__":
    main()
