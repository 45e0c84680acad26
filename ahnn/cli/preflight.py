"""Before the fit: settings that can be, a quiet Lightning, and a folder that holds no other training."""

from __future__ import annotations

import logging
import warnings
from pathlib import Path

from omegaconf import DictConfig

from ahnn.cli.early_stops import held
from ahnn.cli.importing import import_torchmetrics, importing
from ahnn.cli.settings import check_settings
from ahnn.errors import UserError
from ahnn.manifest import require_folder

HINTS = (
    ".*smaller than the logging interval.*",
    ".*does not have many workers.*",
    ".*Checkpoint directory.*exists.*",
    ".*ModelCheckpoint with manual optimization.*",
    ".*isinstance.treespec, LeafSpec.*",
    ".*did not find any unused parameters.*",
    ".*srun. command is available on your system but is not used.*",
    "GPU available but not used.*",
)
"""What Lightning warns of though it is intended, such as short epochs or a login node without `srun`."""

WRITTEN = ("config.yaml", "metrics.json", "predictions.safetensors")
"""Results beside figures and checkpoints."""


def begin(cfg: DictConfig) -> None:
    """Check the settings of a job, and only then import what is heavy.

    Raises:
        UserError: a setting that is impossible.
    """
    check_settings(cfg)
    with importing():
        quiet()


def quiet() -> None:
    """Silence Lightning's warnings about what is intended."""
    with held():
        import_torchmetrics()
        from lightning.pytorch.utilities import rank_zero_only

    for name in ("lightning.pytorch", "lightning.fabric"):
        logging.getLogger(name).setLevel(logging.WARNING)
    if getattr(rank_zero_only, "rank", 0):  # of several processes, one speaks
        logging.getLogger("ahnn").setLevel(logging.WARNING)
    for hint in HINTS:
        warnings.filterwarnings("ignore", hint)


def require_new(folder: Path, ckpt: str | None) -> None:
    """Check that a training replaces no other from the start, and nothing of somebody else at all.

    Raises:
        UserError: the folder holds checkpoints and none is resumed, or files that are not ours.
    """
    from ahnn.evaluation.sinks.figure_files import pictures_in

    checkpoints = sorted((folder / "checkpoints").glob("*.ckpt"))
    if checkpoints and ckpt is None:
        message = (
            f"run {folder}: expected a folder without checkpoints; received one with "
            f"{', '.join(path.name for path in checkpoints)}. Resume with ckpt=last, or choose another run="
        )
        raise UserError(message)
    results = [folder / name for name in WRITTEN]
    files = [*results, *checkpoints, *pictures_in(folder / "figures")]
    require_folder(folder, "run", files, ("figures", "checkpoints", "evaluations", "tensorboard"))
