"""Content fingerprints of trajectories, to detect test data that were used in training."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ahnn.types import Trajectories

SAMPLES = 4
"""Number of consecutive samples in a fingerprint: individual states recur, for example at rest."""
KEPT = 10_000
"""Maximum number of trajectories recorded for a run."""
MIXED = 0x2545F4914F6CDD1D
"""Odd multiplier with well distributed bits (Steele & Vigna 2022, Softw. Pract. Exp. 52, 443)."""
NONE = torch.iinfo(torch.int64).max


def fingerprints(states: Tensor, samples: int = SAMPLES) -> Tensor:
    """Return 64-bit hashes of consecutive states (B, T, D), independent of time, (B, K); NONE if missing."""
    there = states.isfinite().any(-1)
    bits = (states.nan_to_num(0.0) + 0.0).contiguous().view(torch.int64)  # maps -0.0 to 0.0
    of_state = (_mixed(bits) * _odd(states.shape[-1])).sum(-1)
    span = min(samples, states.shape[1])
    of_span = _mixed((of_state.unfold(1, span, 1) * _odd(span)).sum(-1))
    return of_span.masked_fill(~there.unfold(1, span, 1).all(-1), NONE)


def remembered(trajectories: Trajectories) -> list[int]:
    """Return the smallest fingerprint of each trajectory; most of its differently cut versions contain it."""
    least = torch.cat([fingerprints(part.states).amin(1) for part in trajectories.parts()])
    least = least[least != NONE]
    return least[:: -(-len(least) // KEPT) or 1].tolist()


def recognised(trajectories: Trajectories, known: Sequence[int]) -> int:
    """Return the number of trajectories that contain recorded samples."""
    wanted = torch.tensor(known, dtype=torch.int64)
    found = [torch.isin(fingerprints(part.states), wanted).any(1).sum() for part in trajectories.parts()]
    return int(sum(found))


def _mixed(bits: Tensor) -> Tensor:
    """Mix the bits of integers, (...), over all 64 bits."""
    bits = (bits ^ (bits >> 32)) * MIXED
    return (bits ^ (bits >> 29)) * MIXED


def _odd(count: int) -> Tensor:
    """Return distinct odd multipliers, (count,), for the terms of a sum."""
    return _mixed(torch.arange(1, count + 1)) | 1
