"""Train a model and evaluate it: `python -m ahnn.train model=ahnn window=5 system=molniya`.

`cli.training` defines the task, `cli.prepare` builds its parts from the configuration, and `jobs` fits and
evaluates.
"""

from __future__ import annotations

import os

from ahnn.cli.entry import run_hydra
from ahnn.cli.training import train


def main() -> None:
    """Entry point of `python -m ahnn.train` and `ahnn-train`."""
    os.environ.setdefault("TORCH_CPP_LOG_LEVEL", "ERROR")  # DDP warns of intended behaviour
    run_hydra(train)


if __name__ == "__main__":
    main()
