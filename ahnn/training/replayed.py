"""The loss and gradients of a batch on a GPU as one recording of its kernels (a CUDA graph).

A step of a small network is several hundred kernels of a few microseconds each: launched one by one, they
leave the GPU waiting for the next most of the time. A recording is launched at once.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ahnn.training.compilation import Program
from ahnn.training.tracing import Traced

WARM = 3
"""Calls before the recording, in which libraries choose kernels and take their memory."""


def replayed(traced: Traced) -> Program:
    """Return a program that copies its arguments to where the recorded kernels read them, and replays these.

    Each call writes over the results of the one before.

    Args:
        traced: with arguments on a GPU.
    """
    held = [t.clone() for t in traced.arguments]
    device = held[0].device
    beside = torch.cuda.Stream(device)
    beside.wait_stream(torch.cuda.current_stream(device))
    with torch.no_grad(), torch.cuda.stream(beside):
        for _ in range(WARM):
            traced.graph(*held)
    torch.cuda.current_stream(device).wait_stream(beside)
    recording = torch.cuda.CUDAGraph()
    with torch.no_grad(), torch.cuda.graph(recording, capture_error_mode="thread_local"):
        found = traced.graph(*held)

    def call(*given: Tensor) -> list[Tensor]:
        torch._foreach_copy_(held, [*given])  # pyright: ignore[reportPrivateImportUsage]
        recording.replay()
        return found

    call.reads = traced.graph  # pyright: ignore[reportFunctionMemberAccess] - the kernels read its constants
    return Program(call, traced.touched)
