"""Gaussian process in a finite Fourier basis, as a replacement for a network.

A process N ~ GP(0, k) with k(z, z') = s^2 exp(-sum_f (z_f - z'_f)^2 / 2 l_f^2) is approximated with K
fixed frequencies xi_k drawn from N(0, I) (Rahimi & Recht 2007, NeurIPS):

    N(z) = sum_k a_k cos(xi_k . z / l) + b_k sin(xi_k . z / l),    a_k, b_k ~ N(0, s^2 / K)

A Hamiltonian, and its field J grad H in closed form, are then linear in the weights a and b (Tanaka, Iwata &
Ueda 2022, NeurIPS; Ross & Heinonen 2023, TMLR). A cosine is a sine with a phase shift, so N is a network
with one hidden layer of sines. The prior on the weights is that of `ahnn.training.evidence` with precision
K / s^2, and maximum evidence determines the amplitude s.
"""

from __future__ import annotations

import math
from typing import Literal, final

import torch
from torch import Tensor, nn
from torch.nn import functional as F
from torch.quasirandom import SobolEngine

from ahnn.arguments import Count, checked
from ahnn.dynamics.activations import ACTIVATIONS
from ahnn.dynamics.layered import Network
from ahnn.memory import require_memory

BEGIN = 2.0
"""Initial length scales: the range of scaled states. Training shortens lengths that are too long. If they are
too short, the weights fit the noise, since they have no prior before the final steps.
"""


class Waves(nn.Module):
    """Layer z -> (xi_k . z / l + pi/2, xi_k . z / l), whose sines are K cosines and K sines.

    The frequencies are quasi-random: they cover N(0, I) more evenly than random ones, and their kernel is
    correspondingly closer to its limit (Avron, Sindhwani, Yang & Mahoney 2016, JMLR 17, 1).

    Args:
        inputs: number of inputs F.
        count: number of frequencies K.

    Attributes:
        frequencies: xi, (K, F).
        free: (K, 1), 1 for frequencies scaled by the learned lengths; 0 for fixed ones, such as the copies
            added by `ahnn.dynamics.linearised`.
        phases: pi/2 and 0, alternating, (2K,).
    """

    frequencies: Tensor
    free: Tensor
    phases: Tensor

    def __init__(self, inputs: int, count: int) -> None:
        super().__init__()
        seed = int(torch.randint(2**31, ()))
        uniform = SobolEngine(inputs, scramble=True, seed=seed).draw(count, dtype=torch.float64)
        drawn = torch.special.ndtri(uniform.clamp(1e-9, 1 - 1e-9))
        self.log_lengths = nn.Parameter(torch.full((inputs,), BEGIN).log())
        self.register_buffer("frequencies", drawn.to(self.log_lengths))
        self.register_buffer("free", torch.ones(count, 1))
        phases = torch.tensor([math.pi / 2, 0.0]).repeat(count)
        self.register_buffer("phases", phases, persistent=False)

    def weight_at(self, log_lengths: Tensor) -> Tensor:
        """Return xi / l, each row repeated, shape (2K, F), for log lengths, (F,)."""
        return (self.frequencies * (-self.free * log_lengths).exp()).repeat_interleave(2, 0)

    @torch.no_grad()
    def hold(self) -> None:
        """Freeze the lengths: later parameter updates leave them unchanged."""
        self.frequencies.copy_(self.weight[::2])
        self.free.zero_()

    @property
    def weight(self) -> Tensor:
        """Matrix xi / l, each row repeated, shape (2K, F)."""
        return self.weight_at(self.log_lengths)

    @property
    def bias(self) -> Tensor:
        """Phases pi/2 and 0, alternating, shape (2K,)."""
        return self.phases

    def forward(self, z: Tensor) -> Tensor:
        """Return the phases of all waves, shape (..., 2K), at z, shape (..., F)."""
        return F.linear(z, self.weight, self.bias)


@final
@checked
class GaussianProcess(Network):
    """Independent zero-mean Gaussian processes, one per output, with shared length scales.

    The parameters are the logarithms of the lengths, (F,), and the weights, (outputs, 2K).

    Args:
        inputs, outputs: sizes of the first and last layer.
        width: number K of frequencies, each with a cosine and a sine.
        depth: 1.
        activation: fourier.
    """

    def __init__(
        self,
        inputs: int,
        outputs: int,
        *,
        width: Count,
        depth: Literal[1] = 1,
        activation: Literal["fourier"] = "fourier",
    ) -> None:
        super().__init__()
        require_memory("network: width", "waves", 8.0 * 2 * width * (inputs + outputs))
        self.activation = ACTIVATIONS["sine"]
        self.hidden = nn.ModuleList([Waves(inputs, width)])
        self.output = nn.Linear(2 * width, outputs, bias=False)
        nn.init.normal_(self.output.weight, std=0.1 * width**-0.5)

    def write_rows(
        self, theta: Tensor, z: Tensor, slopes: Tensor, values: Tensor | None, out: Tensor
    ) -> None:
        """Write the derivatives of t . dN/dz + v N with respect to log l and the weights; see `Network`.

        With phases p_j = W_j . z, W = xi / l: N = sum w_j sin p_j, dW_jf / dlog l_f = -W_jf.
        """
        (waves,) = self.hidden
        assert isinstance(waves, Waves)
        size = z.shape[-1]
        w, weight = theta[size:], waves.weight_at(theta[:size]).to(theta)
        following = weight * waves.free.to(theta).repeat_interleave(2, 0)
        phase = torch.addmm(waves.phases.to(theta), z, weight.T)
        sine, cosine = phase.sin(), phase.cos()
        gradient = ((w * cosine) @ following).unsqueeze(1)
        along = slopes @ weight.T
        bent = ((w * sine).unsqueeze(1) * along) @ following
        by_weights, by_lengths = out[..., size:], out[..., :size]
        torch.mul(along, cosine.unsqueeze(1), out=by_weights)
        if values is not None:
            v = values.unsqueeze(-1)
            by_weights.addcmul_(v, sine.unsqueeze(1))
            slopes = slopes + v * z.unsqueeze(1)
        by_lengths.copy_(z.unsqueeze(1) * bent - slopes * gradient)
