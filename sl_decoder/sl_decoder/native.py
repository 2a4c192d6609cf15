"""The kernels as a native library, built ahead of time and kept beside the caches of the package's modules.

A library belongs to its sources, interpreter and processor: its name holds a digest of all three, so that one that does
not belong is not found, and the kernels are compiled at run time as if there were none.
"""

from __future__ import annotations

import hashlib
import importlib.machinery
import importlib.util
import json
import platform
import shutil
import sys
import tempfile
import warnings
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

PACKAGE = Path(__file__).parent
FOLDER = PACKAGE / "__pycache__"
NAME = "_kernels"  # of the module
SCALARS = {bool: "bool", np.bool_: "bool", int: "int", np.int64: "int", float: "float", np.float64: "float"}


def kind(value: Any) -> str:
    """Name of a scalar's type as kernels tell them apart; integers of numpy by their size."""
    return SCALARS.get(type(value)) or type(value).__name__


def describe(arguments: tuple[Any, ...]) -> str:
    """Types of arguments as JSON; "" where a native kernel cannot take them (arrays that are not contiguous)."""
    described = _describe(arguments)
    return "" if described is None else json.dumps(described)


def _describe(arguments: tuple[Any, ...]) -> list[Any] | None:
    result: list[Any] = []
    for argument in arguments:
        if isinstance(argument, np.ndarray):
            if not argument.flags.c_contiguous:
                return None
            result.append({"dtype": argument.dtype.str, "ndim": argument.ndim})
        elif isinstance(argument, tuple):
            result.append(_describe(argument))
        else:
            result.append(kind(argument))
    return result


def read(described: str) -> list[Any]:
    """What `describe` wrote: (dtype, dimensions) of arrays, lists for tuples, names of scalars' types."""
    return _parsed(json.loads(described))


def _parsed(described: list[Any]) -> list[Any]:
    result: list[Any] = []
    for one in described:
        if isinstance(one, dict):
            result.append((np.dtype(one["dtype"]), one["ndim"]))
        else:
            result.append(_parsed(one) if isinstance(one, list) else one)
    return result


@cache
def digest() -> str:
    """Digest of what a library depends on."""
    state = hashlib.sha256()
    for path in sorted(PACKAGE.glob("*.py")):
        state.update(path.name.encode())
        state.update(path.read_bytes())
    state.update(f"{sys.version} {platform.machine()} {np.__version__}".encode())
    information = Path("/proc/cpuinfo")
    if information.exists():
        lines = information.read_text(encoding="utf-8", errors="replace").splitlines()
        state.update("".join(sorted({line for line in lines if line.startswith(("flags", "model name"))})).encode())
    return state.hexdigest()[:16]


@cache
def path() -> Path:
    """Where the library for these sources, this interpreter and this processor is or would be."""
    return FOLDER / f"{NAME}.{digest()}{importlib.machinery.EXTENSION_SUFFIXES[0]}"


@cache
def _library() -> tuple[Any, dict[str, Any]]:
    """The library and what its kernels take; None and {} where there is none."""
    try:
        takes = json.loads(path().with_suffix(".json").read_text(encoding="utf-8"))
        specification = importlib.util.spec_from_file_location(f"sl_decoder.{NAME}", path())
        if specification is None or specification.loader is None:
            return None, {}
        module = importlib.util.module_from_spec(specification)
        specification.loader.exec_module(module)
    except (OSError, ImportError, ValueError):
        return None, {}
    return module, {name: read(described) for name, described in takes.items()}


def available() -> bool:
    """Whether this process runs the native library."""
    return _library()[0] is not None


def find(name: str) -> tuple[Any, list[Any]]:
    """The native kernel of this name and the types that it takes; None where there is none."""
    library, takes = _library()
    return getattr(library, name, None), takes.get(name, [])


def build(kernels: list[Any]) -> Path:
    """Build the library of all kernels (`compiled.Kernel`) whose calls were recorded; returns its path.

    Raises what numba and setuptools raise where this machine has no C++ compiler for the glue, or cannot write.
    """
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # of the way to build ahead of time, which numba has been about to replace for years
        from numba.pycc import CC

        FOLDER.mkdir(exist_ok=True)
        with tempfile.TemporaryDirectory(dir=FOLDER) as folder:
            compiler = CC(NAME, source_module="sl_decoder")
            compiler.output_dir = folder
            compiler.target_cpu = "host"
            takes: dict[str, Any] = {}
            for kernel in kernels:
                types = [(types, described) for types, described in (kernel.calls or {}).items() if described]
                if not types:
                    continue
                compiler.export(kernel.name, types[0][0])(_entry(kernel))
                takes[kernel.name] = types[0][1]
            compiler.compile()
            for old in FOLDER.glob(f"{NAME}.*"):
                old.unlink()
            path().with_suffix(".json").write_text(json.dumps(takes), encoding="utf-8")
            shutil.move(next(Path(folder).glob(f"{NAME}*")), path())
    return path()


def _entry(kernel: Any) -> Any:
    """A function of as many arguments that only calls the kernel, which keeps its own options of compilation."""
    code = kernel.function.__code__
    names = ", ".join(code.co_varnames[: code.co_argcount])
    space: dict[str, Any] = {"kernel": kernel.dispatcher}
    exec(f"def entry({names}):\n    return kernel({names})", space)
    return space["entry"]
