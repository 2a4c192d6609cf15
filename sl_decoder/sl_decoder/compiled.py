"""The one way in which this package compiles its loops.

`@compiled` makes a function a kernel. Built ahead of time (`python -m sl_decoder.warmup`, which the build runs) all
kernels are in one native library (native.py), and a process that decodes loads neither numba nor LLVM, which take some
150 MB. Where that library is missing, of other sources or of another machine, or where a kernel is called with other
types, numba compiles at the first call and caches on disk. Either way divisions follow numpy, and floating-point sums
may be reordered, while nan and inf keep their meaning.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from sl_decoder import native

kernels: list[Kernel] = []
"""All kernels of the modules that are loaded."""


class Kernel:
    """A compiled function; called like the function itself, from Python and from other kernels."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function
        self.name = f"{function.__module__.rpartition('.')[2]}__{function.__name__}"
        self.__doc__ = function.__doc__
        self.__name__ = function.__name__
        self.__module__ = function.__module__
        self.calls: dict[tuple[Any, ...], str] | None = None
        """Numba's types of the arguments of the calls from Python so far, where they are to be recorded."""
        self._native, self._takes = native.find(self.name)
        kernels.append(self)

    def __call__(self, *arguments: Any) -> Any:
        """Call the kernel."""
        if self._native is not None and fit(arguments, self._takes):
            return self._native(*arguments)
        if self.calls is not None:
            import numba

            self.calls[tuple(numba.typeof(argument) for argument in arguments)] = native.describe(arguments)
        return self.dispatcher(*arguments)

    @cached_property
    def dispatcher(self) -> Any:
        """The kernel as numba compiles it."""
        from numba import njit

        fastmath = {"contract", "reassoc", "arcp", "nsz"}
        return njit(cache=True, error_model="numpy", fastmath=fastmath)(self.function)

    @property
    def _numba_type_(self) -> Any:
        """What numba takes this object for when another kernel calls it."""
        from numba import types

        return types.Dispatcher(self.dispatcher)


def fit(arguments: tuple[Any, ...], takes: list[Any]) -> bool:
    """Whether arguments have the types that a native kernel was built for: it would not notice others."""
    for argument, expected in zip(arguments, takes, strict=True):
        if type(argument) is np.ndarray:
            if (argument.dtype, argument.ndim) != expected or not argument.flags.c_contiguous:
                return False
        elif isinstance(argument, tuple):
            if type(expected) is not list or len(expected) != len(argument) or not fit(argument, expected):
                return False
        elif native.kind(argument) != expected:
            return False
    return True


def compiled(function: Callable[..., Any]) -> Any:
    """Decorator: make a function a kernel."""
    return Kernel(function)
