"""Process model for online estimation with a learned flow: Q for any step length, with or without memory.

Q is fitted for the sampling interval h of the training data. For a step dt it is scaled like white noise of
constant intensity, Q dt / h; a force error with memory is defined for any step.
"""

from __future__ import annotations

import hashlib
import math
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from safetensors.torch import save
from torch import Tensor, nn

from ahnn.dynamics.recorded_flow import recorded
from ahnn.estimation.covariances import Factor, covariance_factor
from ahnn.estimation.estimator import RecursiveEstimator
from ahnn.estimation.force_error import ForceError
from ahnn.estimation.parameter_error import ParameterError
from ahnn.estimation.process_model import Process
from ahnn.estimation.sensor_error import LENGTHS
from ahnn.numbers import Numbers
from ahnn.types import Flow


def online_process(
    estimator: RecursiveEstimator[Any],
    flow: Flow,
    interval: float,
    process_noise: Numbers,
    force_error: ForceError | ParameterError | None = None,
    about: dict[str, Any] | None = None,
) -> Process:
    """Build the online process of an estimator.

    Args:
        estimator: estimator with its gate.
        flow: the process model, for steps of up to `interval`.
        interval: h, the longest step, and the reference step of `process_noise`.
        process_noise: covariance Q of one step of h, (D, D).
        force_error: error model in addition to Q: of the force, relative and with memory, or of the
            parameters.
        about: plain values that identify the flow and must match a saved state.

    Raises:
        ValueError: Q is not a covariance.
    """
    q = torch.as_tensor(process_noise, dtype=torch.float64)
    chol = covariance_factor(q, "process_noise", batch=1, size=q.shape[-1], definite=False)
    known = {
        **(about or {}),
        **estimator.about,
        "process_noise": q.tolist(),
        "force_error": None if force_error is None else force_error.about,
    }
    if force_error is None:
        return Process(estimator, recorded(flow), WhiteNoise(chol, interval), interval, about=known)
    error = force_error
    noise = lru_cache(LENGTHS)(lambda dt: _augmented(math.sqrt(dt / interval) * chol, error, dt))
    lifted, seen = error.belief, error.measurement
    return Process(estimator, error.flow(recorded(flow)), noise, interval, lifted, seen, known)


class WhiteNoise:
    """White process noise for steps of any length.

    Args:
        chol: (D, D) factor of Q for a step of length `interval`.
        interval: length of that step.
    """

    def __init__(self, chol: Tensor, interval: float) -> None:
        self.chol, self.interval = chol, interval
        self._known = lru_cache(LENGTHS)(lambda dt: Factor(math.sqrt(dt / interval) * chol))

    def __call__(self, dt: float) -> Factor:
        """Return the factor of Q for a step dt."""
        return self._known(dt)

    def each(self, lengths: Tensor) -> Factor:
        """Return the factors (B, D, D) of Q for steps (B,)."""
        # Correctly rounded, like math.sqrt; torch.sqrt may differ in the last bit.
        roots = torch.from_numpy(np.sqrt((lengths / self.interval).numpy()))
        return Factor(roots[:, None, None] * self.chol)


def weights_hash(flow: Flow) -> str:
    """Return the hash of a flow's weights, "" for a flow without weights."""
    if not isinstance(flow, nn.Module):
        return ""
    parts = {name: part.contiguous() for name, part in flow.state_dict().items()}
    return hashlib.blake2b(save(parts), digest_size=16).hexdigest()


def _augmented(chol: Tensor, error: ForceError | ParameterError, dt: float) -> Factor:
    """Return the factor of Q of augmented states for a step dt, given the factor for the state itself."""
    own = error.process_noise(torch.zeros_like(chol), dt)[len(chol) :, len(chol) :].sqrt()
    return Factor(torch.block_diag(chol, own))
