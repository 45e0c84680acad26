"""The same filter in JAX by dynamax and by cuthbert, jitted, over all members: two bodies with J2."""

from __future__ import annotations

import os

flags = " --xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + flags

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from bench_ukf_kernel import AXES_NUMPY, J2, MU, RADIUS, rk4  # noqa: E402
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
    from dynamax.nonlinear_gaussian_ssm import ParamsNLGSSM, UKFHyperParams, unscented_kalman_filter

    p0, q, r = (value * jnp.eye(n) for value, n in zip(noise, (6, 6, 3), strict=True))

    def one(mean: jax.Array, y: jax.Array) -> object:
        model = ParamsNLGSSM(mean, p0, lambda x: rk4(field, x, dt), q, lambda x: x[:3], r)
        return unscented_kalman_filter(model, y, UKFHyperParams(1.0, 2.0, 0.0))

    run, arguments = jax.jit(jax.vmap(one)), (jnp.asarray(start), jnp.asarray(rows))
    return lambda: jax.block_until_ready(run(*arguments))


def cuthbert_filter(
    start: np.ndarray, rows: np.ndarray, noise: tuple[float, float, float], dt: float
) -> Work:
    """Return work: the same filter by roots of covariances, of the parts that cuthbert has for it."""
    from cuthbertlib.kalman import filter_update
    from cuthbertlib.linalg import tria
    from cuthbertlib.quadrature import SigmaPoints, unscented

    p0, q, r = (value**0.5 * jnp.eye(n) for value, n in zip(noise, (6, 6, 3), strict=True))
    weights, sees = unscented.weights(6, 1.0, 2.0, 0.0), jnp.eye(3, 6)

    def step(belief: tuple, y: jax.Array) -> tuple[tuple, tuple]:
        points = weights.get_sigma_points(*belief)
        moved = SigmaPoints(jax.vmap(lambda x: rk4(field, x, dt))(points.points), points.wm, points.wc)
        root = tria(jnp.concatenate((moved.sqrt, q), axis=1))
        belief, _ = filter_update(moved.mean, root, sees, jnp.zeros(3), r, y)
        return belief, belief

    run = jax.jit(jax.vmap(lambda mean, y: jax.lax.scan(step, (mean, p0), y)[1]))
    arguments = jnp.asarray(start), jnp.asarray(rows)
    return lambda: jax.block_until_ready(run(*arguments))
