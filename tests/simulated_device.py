"""A simulated accelerator: tensors computed on the CPU, which refuse operations that mix devices.

Tensors of the device `DEVICE` hold their values in a CPU tensor. Their operations follow the rules of CUDA:
all tensors are on one device, except those without dimensions in pointwise operations, and indices.
Neither speed nor rounding of a GPU is simulated, nor are CUDA streams, graphs and compiled kernels.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

DEVICE = torch.device("meta")
"""Device of the simulated tensors: in torch the only one that backward passes support without a backend."""
COPY = torch.ops.aten.copy_.default
COPIES = {COPY, torch.ops.aten._to_copy.default}
"""Operations between devices."""
INDEXED = {torch.ops.aten.index, torch.ops.aten.index_put, torch.ops.aten.index_put_}
"""Operations that accept indices on the CPU; values assigned from there must lack dimensions."""
SCALARS = {torch.ops.aten.masked_fill, torch.ops.aten.masked_fill_, torch.ops.aten.fill, torch.ops.aten.fill_}
"""Operations besides pointwise ones that accept a tensor without dimensions from the CPU."""
FROM_VALUES = {torch.tensor, torch.as_tensor, torch.asarray, Tensor.new_tensor}
"""Functions from Python numbers to tensors, which bypass dispatch."""


class SimulatedTensor(Tensor):
    """Tensor on the simulated device.

    Attributes:
        values: its values, on the CPU.
    """

    values: Tensor
    is_meta = False
    __torch_function__ = torch._C._disabled_torch_function_impl  # pyright: ignore[reportAssignmentType]

    @staticmethod
    def __new__(cls, values: Tensor):
        layout = {"strides": values.stride(), "storage_offset": values.storage_offset()}
        found = Tensor._make_wrapper_subclass(  # pyright: ignore[reportAttributeAccessIssue]
            cls, values.size(), dtype=values.dtype, device=DEVICE, **layout
        )
        found.values = values
        return found

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None):
        del types
        return computed(func, args, kwargs or {})

    def tolist(self):
        return self.values.tolist()

    def __reduce_ex__(self, protocol: Any):
        return self.values.detach().__reduce_ex__(protocol)  # read back on the CPU

    def __repr__(self, *, tensor_contents: Any = None):
        del tensor_contents
        return f"SimulatedTensor({self.values})"


def mapped(value: Any, function: Any):
    """Apply a function to the tensors in nested lists and tuples."""
    if isinstance(value, Tensor):
        return function(value)
    return type(value)([mapped(one, function) for one in value]) if type(value) in (list, tuple) else value


def computed(func: Any, args: Any, kwargs: dict[str, Any]):
    """Return the result of an operation, on the device that CUDA would choose."""
    given, known = [], {}

    def plain(one: Tensor):
        given.append(one)
        if not isinstance(one, SimulatedTensor):
            return one
        known[id(one.values)] = one
        return one.values

    own_args = mapped(args, plain)
    own = {name: mapped(value, plain) for name, value in kwargs.items()}
    there, wanted = bool(known), kwargs.get("device")
    if there:
        require_one_device(func, args, given)
    if wanted is not None:
        there = torch.device(wanted) == DEVICE
        if there and kwargs.get("generator") is not None:
            message = f"{func}: expected a generator of the device {DEVICE}; received one of the CPU"
            raise RuntimeError(message)
        own["device"] = "cpu"
    found = func(*own_args, **own)
    if not there or func is COPY:
        return args[0] if func is COPY else found
    return mapped(found, lambda one: known[id(one)] if id(one) in known else SimulatedTensor(one))


def require_one_device(func: Any, args: Any, given: list[Tensor]) -> None:
    """Raise RuntimeError for tensors on two devices, as operations of CUDA do."""
    foreign, packet = [one for one in given if not isinstance(one, SimulatedTensor)], func.overloadpacket
    if not foreign or func in COPIES:
        return
    small = torch.Tag.pointwise in func.tags or packet in SCALARS
    if packet in INDEXED and isinstance(args[0], SimulatedTensor):
        foreign, small = [one for one in args[2:3] if not isinstance(one, SimulatedTensor)], True
    for one in foreign:
        if one.ndim or not small:
            message = f"{func}: expected all tensors on {DEVICE}; received {tuple(one.shape)} on {one.device}"
            raise RuntimeError(message)


class _Dispatch(TorchDispatchMode):
    """Factories with `device=DEVICE`, and operations on tensors of both devices."""

    @classmethod
    def _should_skip_dynamo(cls):
        return False  # nothing is compiled, and the wrapper would import the compiler

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None):
        del types
        return computed(func, args, kwargs or {})


class _Functions(TorchFunctionMode):
    """Functions that bypass dispatch: tensors from Python numbers, and assignments to `data`."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None):
        del types
        kwargs = kwargs or {}
        like = args[0] if func is Tensor.new_tensor else None
        if like is not None:
            kwargs = {"dtype": like.dtype, "device": like.device, **kwargs}
        of_numbers = func in FROM_VALUES and not isinstance(args[0 if like is None else 1], Tensor)
        if of_numbers and kwargs.get("device") is not None and torch.device(kwargs["device"]) == DEVICE:
            return torch.tensor(args[0 if like is None else 1], **{**kwargs, "device": "cpu"}).to(DEVICE)
        found = func(*args, **kwargs)
        if func == Tensor.data.__set__ and isinstance(args[0], SimulatedTensor):
            args[0].values = args[1].values
        return found


@contextmanager
def simulated_device() -> Iterator[torch.device]:
    """Simulate the device inside the context, and return it."""
    known = torch.is_autocast_enabled  # not defined for the device

    def enabled(*device: Any):
        return known(*device) if device != (DEVICE.type,) else False

    with patch.object(torch, "is_autocast_enabled", enabled), _Functions(), _Dispatch():
        yield DEVICE
