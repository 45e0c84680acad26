"""Checks before training: settings, Lightning warnings, and an unused run folder."""

from __future__ import annotations

import logging
import warnings
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

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
"""Lightning warnings about intended settings, such as short epochs or a login node without `srun`."""

WRITTEN = ("config.yaml", "metrics.json", "predictions.safetensors")
"""Result files besides figures and checkpoints."""


def begin(cfg: DictConfig) -> None:
    """Check the settings of a job before heavy imports.

    Raises:
        UserError: an impossible setting.
    """
    check_settings(cfg)
    with importing():
        quiet()


def quiet() -> None:
    """Silence Lightning's warnings about intended settings."""
    with held():
        import_torchmetrics()
        from lightning.pytorch.utilities import rank_zero_only

    for name in ("lightning.pytorch", "lightning.fabric"):
        logging.getLogger(name).setLevel(logging.WARNING)
    if getattr(rank_zero_only, "rank", 0):  # only one of several processes logs
        logging.getLogger("ahnn").setLevel(logging.WARNING)
    for hint in HINTS:
        warnings.filterwarnings("ignore", hint)


def require_folder_name(cfg: DictConfig) -> None:
    """Raise UserError for an empty name of the run folder, which would be the working directory."""
    if not OmegaConf.is_interpolation(cfg, "run") and cfg.get("run") == "":
        message = "run: expected a folder; received none, as from an unset variable. Use run=runs/NAME"
        raise UserError(message)


def require_new(folder: Path, ckpt: str | None) -> None:
    """Check that a training run overwrites neither another run nor foreign files.

    Raises:
        UserError: the folder contains checkpoints but none is resumed, a saved model, or foreign files.
    """
    from ahnn.evaluation.sinks.figure_files import pictures_in
    from ahnn.stored import SAVED

    if (folder / SAVED).exists():
        message = (
            f"run {folder}: expected a folder without weights; received one with {SAVED}, a saved model. "
            "Choose another run"
        )
        raise UserError(message)
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
