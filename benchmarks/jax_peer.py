"""The same work in JAX, Equinox and Optax, jitted: a training step and a rollout of a Hamiltonian network."""

from __future__ import annotations

import os

flags = " --xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + flags

import equinox as eqx  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
import optax  # noqa: E402
from timing import Work  # noqa: E402

jax.config.update("jax_enable_x64", True)
ACTIVATIONS = {"gelu": lambda z: jax.nn.gelu(z, approximate=False), "tanh": jnp.tanh}


def network(width: int, depth: int, activation: str, size: int, dtype: type) -> eqx.Module:
    """Return a scalar network of the states."""
    key = jax.random.PRNGKey(0)
    return eqx.nn.MLP(size, "scalar", width, depth, ACTIVATIONS[activation], dtype=dtype, key=key)


def increment(energy: eqx.Module, x: jax.Array, dt: float) -> jax.Array:
    """Return the increments (B, D) of one classical Runge-Kutta step."""
    gradient = jax.vmap(jax.grad(energy))

    def field(x: jax.Array) -> jax.Array:
        dq, dp = jnp.split(gradient(x), 2, axis=-1)
        return jnp.concatenate((dp, -dq), axis=-1)

    k1 = field(x)
    k2 = field(x + dt / 2 * k1)
    k3 = field(x + dt / 2 * k2)
    k4 = field(x + dt * k3)
    return dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def training_step(net: eqx.Module, start: np.ndarray, targets: np.ndarray, dt: float, steps: int) -> Work:
    """Return work: optimiser steps with AdamW on the Huber loss of W recursive predictions."""
    optimizer = optax.adamw(1e-3, weight_decay=0.01)

    def loss(net: eqx.Module, start: jax.Array, targets: jax.Array) -> jax.Array:
        x, residual, total = start, jnp.zeros_like(start), 0.0
        for k in range(targets.shape[1]):
            predicted = increment(net, x, dt)
            x, residual = x + predicted, residual + predicted - targets[:, k]
            total = total + optax.losses.huber_loss(residual).mean()
        return total / targets.shape[1]

    @eqx.filter_jit(donate="all-except-first")
    def step(data: tuple, net: eqx.Module, state: optax.OptState) -> tuple:
        gradients = eqx.filter_grad(loss)(net, *data)
        updates, state = optimizer.update(gradients, state, eqx.filter(net, eqx.is_array))
        return eqx.apply_updates(net, updates), state

    current = [(net, optimizer.init(eqx.filter(net, eqx.is_array)))]
    data = (jnp.asarray(start), jnp.asarray(targets))

    def work() -> None:
        for _ in range(steps):
            current[0] = step(data, *current[0])
        jax.block_until_ready(eqx.filter(current[0][0], eqx.is_array))

    return work


def rollout(net: eqx.Module, start: np.ndarray, dt: float, steps: int) -> Work:
    """Return work: a scan over the steps, all states kept."""

    @eqx.filter_jit
    def run(net: eqx.Module, x: jax.Array) -> jax.Array:
        def body(x: jax.Array, _: None) -> tuple[jax.Array, jax.Array]:
            x = x + increment(net, x, dt)
            return x, x

        return jax.lax.scan(body, x, length=steps)[1]

    x = jnp.asarray(start)
    return lambda: jax.block_until_ready(run(net, x))


def diffrax_rollout(net: eqx.Module, start: np.ndarray, dt: float, steps: int) -> Work:
    """Return work: the rollout by diffrax in steps of one size, its solver with the classical tableau."""
    import diffrax

    class RK4(diffrax.AbstractERK):
        tableau = diffrax.ButcherTableau(
            c=np.array((0.5, 0.5, 1.0)),
            a_lower=(np.array((0.5,)), np.array((0.0, 0.5)), np.array((0.0, 0.0, 1.0))),
            b_sol=np.array((1.0, 2.0, 2.0, 1.0)) / 6,
            b_error=np.zeros(4),
        )
        interpolation_cls = diffrax.ThirdOrderHermitePolynomialInterpolation.from_k

        def order(self, terms: object) -> int:
            return 4

    def field(_: jax.Array, x: jax.Array, energy: eqx.Module) -> jax.Array:
        dq, dp = jnp.split(jax.vmap(jax.grad(energy))(x), 2, axis=-1)
        return jnp.concatenate((dp, -dq), axis=-1)

    @eqx.filter_jit
    def run(net: eqx.Module, x: jax.Array) -> jax.Array:
        saves, term = diffrax.SaveAt(steps=True), diffrax.ODETerm(field)
        span = 0.0, steps * dt, dt
        return diffrax.diffeqsolve(term, RK4(), *span, x, net, saveat=saves, max_steps=steps).ys

    x = jnp.asarray(start)
    return lambda: jax.block_until_ready(run(net, x))


def second_order(net: eqx.Module, start: np.ndarray, slopes: np.ndarray) -> Work:
    """Return work: one step of optimistix's Levenberg-Marquardt on the field less its targets."""
    import optimistix as optx

    parameters, static = eqx.partition(net, eqx.is_inexact_array)
    solver = optx.LevenbergMarquardt(rtol=1e-12, atol=1e-12)

    def residuals(parameters: eqx.Module, data: tuple) -> jax.Array:
        dq, dp = jnp.split(jax.vmap(jax.grad(eqx.combine(parameters, static)))(data[0]), 2, axis=-1)
        return jnp.concatenate((dp, -dq), axis=-1) - data[1]

    @eqx.filter_jit
    def run(parameters: eqx.Module, data: tuple) -> eqx.Module:
        return optx.least_squares(residuals, solver, parameters, data, max_steps=1, throw=False).value

    data = jnp.asarray(start), jnp.asarray(slopes)
    return lambda: jax.block_until_ready(run(parameters, data))
