"""Parts of a computation side by side: as many as the process may run, in order, and the same bits."""

from __future__ import annotations

import os
import threading

import pytest
import torch
from helpers import generator

from ahnn.cores import cores, each, slices
from ahnn.training.normal_equations import PANEL, gram

CPU = torch.device("cpu")


@pytest.mark.parametrize(
    ("limit", "threads", "count"),
    [
        (None, 1, 2),
        ("1", 1, 1),
        ("100000", 1, 2),
        ("0", 1, 2),
        ("x", 1, 2),
        ("-1", 1, 2),
        (None, 2, 1),
        (None, 3, 1),
    ],
)
def test_cores_are_those_of_the_process_and_no_more_than_omp_num_threads(two, limit, threads, count):
    if limit is not None:
        two.setenv("OMP_NUM_THREADS", limit)
    torch.set_num_threads(threads)
    assert cores() == count


def test_parts_run_side_by_side_in_order_and_without_gradients(two):
    both = threading.Barrier(2, timeout=60)

    def work(part):
        both.wait()  # passes only where two run at once
        return part, torch.is_grad_enabled()

    assert each(work, range(4), CPU) == [(k, False) for k in range(4)]
    two.setenv("OMP_NUM_THREADS", "1")
    assert each(lambda _: threading.current_thread(), [0, 1], CPU) == 2 * [threading.main_thread()]


@pytest.mark.usefixtures("two")
def test_a_part_may_be_made_of_parts_and_an_error_comes_out():
    assert each(lambda n: sum(each(lambda k: k, range(n), CPU)), [3, 4], CPU) == [3, 6]
    with pytest.raises(ZeroDivisionError):
        each(lambda n: 1 // n, [1, 0], CPU)


@pytest.mark.usefixtures("two")
def test_a_forked_process_has_threads_of_its_own():
    each(lambda k: k, range(2), CPU)
    child = os.fork()
    if child == 0:
        os._exit(0 if each(lambda k: k, range(2), CPU) == [0, 1] else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


@pytest.mark.parametrize(("count", "expected"), [(0, [0]), (4, [4]), (5, [4, 1])])
def test_slices_cover_all_rows(count, expected):
    found = slices(count, 4)
    assert [len(range(count)[part]) for part in found] == expected
    assert found[-1].stop == count


@pytest.mark.parametrize("count", [1, PANEL, PANEL + 1, 2 * PANEL + 7])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_gram_matrix_is_the_product_and_has_the_same_bits_on_two_cores(two, count, dtype):
    jacobian = torch.randn(50, count + 3, generator=generator(0)).to(dtype)[:, 1:-2]
    found = gram(jacobian)
    exact = jacobian.double().T @ jacobian.double()
    torch.testing.assert_close(found.double(), exact, rtol=0, atol=1e3 * torch.finfo(dtype).eps)
    assert torch.equal(found[PANEL:, :PANEL], found[:PANEL, PANEL:].T)
    two.setenv("OMP_NUM_THREADS", "1")
    assert torch.equal(found, gram(jacobian))
