"""Export learned dynamics for other programs: `python -m ahnn.export run=DIR output=FOLDER`.

run=DIR             a run folder
pretrained=NAME     a model that comes with the package
ckpt=best           the weights: best, last, or a path
output=FOLDER       a new one: flow and energy as .pt2 and .onnx, weights.safetensors, model.json
"""

from __future__ import annotations

if __name__ == "__main__":  # until `guard` listens, Ctrl-C ends this process without a traceback
    import signal

    signal.signal(signal.SIGINT, signal.SIG_DFL)

from dataclasses import dataclass
from pathlib import Path

from ahnn.cli.guard import run_command
from ahnn.cli.importing import importing

USAGE = "usage: python -m ahnn.export run=DIR | pretrained=NAME output=FOLDER [ckpt=best]"


@dataclass(frozen=True, kw_only=True)
class Asked:
    """The keys of the command; the module's help says what they are."""

    output: str
    run: str | None = None
    pretrained: str | None = None
    ckpt: str = "best"


def export(arguments: list[str]) -> None:
    """Write the graphs of a run into a new folder.

    Raises:
        UserError: no such run, one that has no graph, or a folder that exists.
    """
    with importing():
        from ahnn.cli.pairs import named_runs, read_pairs
        from ahnn.evaluation.terminal import show
        from ahnn.graphs import write_export

    asked = read_pairs(arguments, Asked, USAGE)
    (run,) = named_runs(asked.run, asked.pretrained, asked.ckpt)
    files = write_export(run, Path(asked.output))
    show(f"{run.folder.name}: {', '.join(files)} in {asked.output}")


def main() -> None:
    """Entry point of `python -m ahnn.export` and `ahnn-export`."""
    run_command(export, __doc__)


if __name__ == "__main__":
    main()
