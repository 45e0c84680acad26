"""Checks that the recipe of a training run suits its data, before anything is built."""

from __future__ import annotations

from collections.abc import Iterable

from omegaconf import DictConfig, OmegaConf

from ahnn.errors import UserError

NAMES_A_RECIPE = ("recipe=", "loss=")


def check_recipe(cfg: DictConfig, overrides: Iterable[str]) -> None:
    """Reject noise with an implicit recipe for exact samples, and `window` with a recipe for segments.

    Raises:
        UserError: such options; the message names them and the implicit recipe.
    """
    named = [text for text in overrides if text.startswith("window=")]
    noise = OmegaConf.select(cfg, "data.noise")
    if "stages" in (OmegaConf.select(cfg, "loss") or {}):
        if named:
            message = (
                "window: expected none, since loss.stages sets the lengths of segments; received "
                f"{named[-1]!r}. Set loss.stages, or choose a recipe for exact states, such as "
                "recipe=second_order"
            )
            raise UserError(message)
    elif noise is not None and not any(text.startswith(NAMES_A_RECIPE) for text in overrides):
        choices = OmegaConf.select(cfg, "hydra.runtime.choices") or {}
        if (sensor := choices.get("sensor") or "none") != "none":
            message = (
                f"data.noise: expected a loss for measurements; received model={choices.get('model')}, which "
                f"sets loss={choices.get('loss')} in place of that of sensor={sensor}. Use model=ahnn, or "
                "add loss=shooting"
            )
            raise UserError(message)
        message = (
            "data.noise: expected a recipe for noisy measurements; received noise with a recipe for exact "
            "samples. Use recipe=measurements, recipe=noisy_states for densely sampled states, "
            "recipe=dense_states for densely sampled orbits, or a sensor option (sensor=recorded for "
            "files), which selects a recipe"
        )
        raise UserError(message)


def check_potential(cfg: DictConfig, overrides: Iterable[str]) -> None:
    """Reject an implicit sensor recipe that is known to fail from random initial weights.

    Raises:
        UserError: positions of orbits with unknown potential and shooting in the first stage.
    """
    choices = OmegaConf.select(cfg, "hydra.runtime.choices") or {}
    meant = choices.get("sensor") == "orbit_positions" and choices.get("hamiltonian") == "mechanical"
    stages = OmegaConf.select(cfg, "loss.stages") or [[None]]
    begun = cfg.get("ckpt") is not None or cfg.get("weights") is not None
    named = any(text.startswith(NAMES_A_RECIPE) for text in overrides)
    if meant and isinstance(stages[0][0], int) and not begun and not named:
        message = (
            "recipe: expected a recipe that learns a full potential from orbital positions; received none, "
            "and the sensor's default recipe does not find the orbits. Use recipe=noisy_positions, or "
            "hamiltonian=central_body if the central body is known"
        )
        raise UserError(message)
