"""Conversion of modules to torch.export programs and ONNX, in double precision for any batch size."""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from collections.abc import Iterator
from typing import Any

import torch
from torch import nn
from torch.export import Dim, ExportedProgram, export

from ahnn.optional_libraries import library

INPUT, CLOCK, OUTPUT = "states", "clock", "result"
"""Input and output names of the ONNX graphs."""


def program(module: nn.Module, *sizes: int) -> ExportedProgram:
    """Export a module of states (B, D), and of a clock (B, k) if a second size is given."""
    examples, batch = tuple(torch.ones(2, size, dtype=torch.float64) for size in sizes), Dim("batch")
    with quiet():
        return export(module.eval(), examples, dynamic_shapes=tuple({0: batch} for _ in sizes))


def as_pt2(found: ExportedProgram) -> bytes:
    """Return a program as the content of a .pt2 file."""
    buffer = io.BytesIO()
    with quiet():
        torch.export.save(found, buffer)
    return buffer.getvalue()


def as_onnx(found: ExportedProgram) -> bytes:
    """Return a program as the content of an .onnx file.

    Raises:
        UserError: the required packages are not installed.
    """
    require_onnx()
    import numpy as np
    from onnx import TensorProto, numpy_helper

    with quiet():
        inputs = [INPUT, CLOCK][: len(found.graph_signature.user_inputs)]
        names: Any = {"input_names": inputs, "output_names": [OUTPUT]}
        made: Any = torch.onnx.export(found, dynamo=True, verbose=False, **names)
    model = made.model_proto
    exact = {float(np.float32(factor)): factor for factor in factors(found)}
    for constant in model.graph.initializer:
        value = numpy_helper.to_array(constant)
        if constant.data_type == TensorProto.DOUBLE and value.ndim == 0 and float(value) in exact:
            whole = np.array(exact[float(value)])
            constant.CopyFrom(numpy_helper.from_array(whole, constant.name))
    return model.SerializeToString()


def factors(found: ExportedProgram) -> set[float]:
    """Return the constants in a program, which torch's exporter rounds to single precision."""
    given = (value for node in found.graph.nodes for value in (*node.args, *node.kwargs.values()))
    return {value for value in given if isinstance(value, float)}


def require_onnx() -> None:
    """Raise UserError if the packages for ONNX are not installed."""
    for package in ("onnx", "onnxscript"):
        library(package, package, "export", "export")


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Silence warnings of torch's exporters about other packages and about their own deprecations."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)
