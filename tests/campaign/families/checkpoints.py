"""Checkpoints and weights with damaged bytes: refused, or the very weights that were written."""

from __future__ import annotations

from functools import partial

import torch

from ahnn.checkpoints import FORMAT, Weights, read_weights, write_weights
from ahnn.dynamics import make_dynamics
from ahnn.loading import made
from ahnn.stored import about_space
from ahnn.types import Space

from .damage import damaged

SPEC = {
    "kind": "hamiltonian",
    "dof": 1,
    "inertia": 1.0,
    "hamiltonian": "generic",
    "mu": None,
    "inputs": "cartesian",
    "scaling": "block",
    "network": {"width": 6, "depth": 2, "activation": "tanh"},
    "integrator": {"name": "rk4"},
}


def cases(draw, folder):
    """Yield damaged checkpoints and weight files."""
    dynamics = make_dynamics(**SPEC)
    about = {"format": FORMAT, "dynamics": SPEC, "space": about_space(Space("s", ("q", "p"))), "dt": 0.1}
    state = {f"dynamics.{k}": v for k, v in dynamics.state_dict().items()}
    torch.save({"state_dict": state, "ahnn": about}, folder / "good.ckpt")
    write_weights(folder / "good.safetensors", Weights(dict(dynamics.state_dict()), about))
    while True:
        suffix = draw.choice([".ckpt", ".safetensors"])
        what, content = damaged(draw, (folder / f"good{suffix}").read_bytes())
        yield f"{suffix} {what}", partial(attempt, folder / f"bad{suffix}", content, dynamics)


def attempt(path, content, dynamics) -> None:
    """Load a damaged file; what is accepted must be what was written."""
    path.write_bytes(content)
    loaded = made(read_weights(path), path.parent).dynamics.state_dict()
    for name, tensor in dynamics.state_dict().items():
        assert torch.equal(tensor.double(), loaded[name].double()), f"another {name}"
