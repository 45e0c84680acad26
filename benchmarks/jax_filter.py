"""The same filter in JAX by dynamax, jitted, over all members: two bodies with J2, an update each step."""

from __future__ import annotations

import os

flags = " --xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + flags

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from bench_ukf_kernel import AXES_NUMPY, J2, MU, RADIUS, rk4  # noqa: E402
from dynamax.nonlinear_gaussian_ssm import (  # noqa: E402
    ParamsNLGSSM,
    UKFHyperParams,
    unscented_kalman_filter,
)
from timing import Work  # noqa: E402

jax.config.update("jax_enable_x64", True)


def field(x: jax.Array) -> jax.Array:
    """Return the time derivative of one orbit (6,), km and km/s."""
    q = x[:3]
    r2 = q @ q
    z2 = 5.0 * q[2] * q[2] / r2
    factor = 1.5 * J2 * RADIUS**2 / r2
    pull = q * (1.0 + factor * (AXES_NUMPY - z2)) * (-MU / (r2 * jnp.sqrt(r2)))
    return jnp.concatenate((x[3:], pull))


def dynamax_filter(start: np.ndarray, rows: np.ndarray, noise: tuple[float, float, float], dt: float) -> Work:
    """Return work: the filter from starts (B, 6) along rows (B, T, 3); variances of P0, Q and R."""
    p0, q, r = (value * jnp.eye(n) for value, n in zip(noise, (6, 6, 3), strict=True))

    def one(mean: jax.Array, y: jax.Array) -> object:
        model = ParamsNLGSSM(mean, p0, lambda x: rk4(field, x, dt), q, lambda x: x[:3], r)
        return unscented_kalman_filter(model, y, UKFHyperParams(1.0, 2.0, 0.0))

    run, arguments = jax.jit(jax.vmap(one)), (jnp.asarray(start), jnp.asarray(rows))
    return lambda: jax.block_until_ready(run(*arguments))
