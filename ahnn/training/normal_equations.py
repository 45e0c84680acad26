"""Normal equations J^T J s = -J^T r of a batch, in blocks of parameters that share no residual.

Blocks follow from the zeros of the Jacobian. T(p) + V(q) fitted to derivatives has two blocks of half the
size, a known kinetic energy makes half of the rows zero, and no residual depends on the additive constant of
an energy.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import islice
from typing import NamedTuple

import torch
from torch import Tensor

from ahnn.cores import each, slices

PANEL = 160
"""Number of columns in a product for J^T J: few to limit work above the diagonal, many for efficient BLAS."""
TOGETHER = 8
"""Number of parts whose equations are kept before summation."""


class Block(NamedTuple):
    """Normal equations of a block of K parameters.

    Attributes:
        columns: indices of the parameters, shape (K,).
        matrix: J^T J, shape (K, K).
        gradient: J^T r, shape (K,).
        units: units of the parameters, shape (K,), in which sizes of steps are compared; None: all 1.
    """

    columns: Tensor
    matrix: Tensor
    gradient: Tensor
    units: Tensor | None = None


class Equations(NamedTuple):
    """Quadratic model of a least-squares problem.

    Attributes:
        loss: sum of squared residuals.
        degrees: degrees of freedom: number of residuals minus eliminated unknowns.
        blocks: blocks of the normal equations.
    """

    loss: Tensor
    degrees: int
    blocks: list[Block]


class ResidualRows(NamedTuple):
    """Subset of the residuals of a problem.

    Attributes:
        loss: contribution to the loss.
        residuals: r, shape (N,).
        jacobian: J, shape (N, P); products are formed in its precision.
    """

    loss: Tensor
    residuals: Tensor
    jacobian: Tensor


def memory_of(parameters: int, rows: int) -> float:
    """Estimate the memory of a step in bytes: J, and J^T J during factorisation.

    J is float32, plus half its size during construction; J^T J, its damped copy and the factor are float64.
    """
    return 6.0 * rows * parameters + 24.0 * parameters**2


def memory_of_parts(parameters: int) -> float:
    """Estimate the memory of `accumulated` in bytes: equations of parts and their sum, float64."""
    return 8.0 * (TOGETHER + 1) * parameters**2


def accumulated(
    rows: Callable[[slice], ResidualRows], parts: Iterable[slice], theta: Tensor, degrees: int
) -> Equations:
    """Sum the equations of one or more parts, computed in parallel, in one block.

    Args:
        rows: function from a part to its residuals.
        parts: parts of the problem.
        theta: parameter vector, which defines dtype, device and columns of the equations.
        degrees: degrees of freedom.
    """

    def summed(part: slice) -> tuple[Tensor, Tensor, Tensor]:
        own = rows(part)
        gradient = own.jacobian.T @ own.residuals.to(own.jacobian)
        return own.loss, gradient.to(theta), gram(own.jacobian).to(theta)

    every, total = iter(parts), list[Tensor]()
    while some := list(islice(every, TOGETHER)):
        for own in each(summed, some, theta.device):
            total = [one.add_(other) for one, other in zip(total, own, strict=True)] if total else [*own]
    loss, gradient, matrix = total
    columns = torch.arange(len(gradient), device=gradient.device)
    return Equations(loss, degrees, [Block(columns, matrix, gradient)])


def normal_equations(jacobian: Tensor, residuals: Tensor, sizes: Sequence[int]) -> list[Block]:
    """Form the blocks; parameters without influence on residuals are omitted.

    Args:
        jacobian: J, shape (N, P). Products are formed in its precision.
        residuals: r, shape (N,). The blocks are in its precision.
        sizes: sizes of the tensors that form the P parameters; a tensor is never split.
    """
    used = torch.stack([used_rows(part) for part in jacobian.split(list(sizes), dim=-1)], dim=-1)
    columns = torch.arange(jacobian.shape[1], device=jacobian.device).split(list(sizes))
    blocks = []
    for members in independent(used):
        block = torch.cat([part for part, member in zip(columns, members.tolist(), strict=True) if member])
        rows = used[:, members].any(-1)
        own, left = _columns(jacobian, block), residuals
        if not bool(rows.all()):
            own, left = own[rows], residuals[rows]
        gradient = own.T @ left.to(own)
        blocks.append(Block(block, gram(own).to(residuals), gradient.to(residuals)))
    return blocks


def used_rows(part: Tensor) -> Tensor:
    """Return the mask of nonzero rows (N,) of columns (N, K); often one column is nonzero in all of them."""
    one = part[:, part.shape[1] // 2 :][:, :1].any(-1)
    return one if bool(one.all()) else part.any(-1)


def _columns(jacobian: Tensor, block: Tensor) -> Tensor:
    """Return selected columns, without a copy if they are contiguous."""
    first, last = int(block[0]), int(block[-1])
    return jacobian[:, first : last + 1] if last - first + 1 == len(block) else jacobian[:, block]


def independent(used: Tensor) -> Tensor:
    """Partition the columns of `used`, bool (N, G), into sets that share no row, as bool (sets, G).

    They are the connected components of the graph in which two columns are neighbours if a row uses both.
    """
    columns = used.float()
    reach = columns.T @ columns > 0
    for _ in range(used.shape[1].bit_length()):
        reach = reach.float() @ reach.float() > 0
    return reach[reach.any(-1)].unique(dim=0)


def gram(jacobian: Tensor) -> Tensor:
    """Return J^T J, shape (P, P): lower triangle by panels, mirrored."""
    count = jacobian.shape[1]
    matrix = jacobian.new_empty(count, count)

    def write(own: slice) -> None:
        panel = matrix[own, : own.stop]
        torch.mm(jacobian[:, own].T, jacobian[:, : own.stop], out=panel)
        matrix[: own.start, own] = panel[:, : own.start].T

    each(write, slices(count, PANEL, jacobian.device)[::-1], jacobian.device)  # largest panels first
    return matrix


def gradient_norm(blocks: Sequence[Block]) -> float:
    """Return |J^T r|, half the norm of the gradient of r^T r."""
    return math.hypot(*(float(block.gradient.norm()) for block in blocks))


def metric(block: Block) -> Tensor:
    """Return D, shape (K,): the diagonal of J^T J plus a thousandth of its mean, in `block.units`."""
    diagonal = block.matrix.diagonal()
    if block.units is None:
        return diagonal + 1e-3 * diagonal.mean()
    squares = block.units.square()
    return diagonal + 1e-3 * (diagonal * squares).mean() / squares


def damped_step(blocks: Sequence[Block], damping: float, theta: Tensor) -> Tensor | None:
    """Return the solution s of (J^T J + damping D) s = -J^T r in the parameters theta, both of shape (P,).

    D is the `metric`. Returns None if a block is not positive definite.
    """
    step = torch.zeros_like(theta)
    for block in blocks:
        damped = block.matrix.clone()
        damped.diagonal().add_(damping * metric(block))
        factor, info = torch.linalg.cholesky_ex(damped)
        if int(info) != 0:
            return None
        step[block.columns] = -torch.cholesky_solve(block.gradient.unsqueeze(-1), factor).squeeze(-1)
    return step


def promised_decrease(blocks: Sequence[Block], step: Tensor) -> Tensor:
    """Return r^T r - |r + J s|^2 of a step s, shape (P,), by the linear model of the residuals."""
    decrease = step.new_zeros(())
    for block in blocks:
        own = step[block.columns]
        decrease = decrease - (2 * block.gradient @ own + own @ (block.matrix @ own))
    return decrease
