"""Maps found before, in the user's cache folder, by everything that decides what is found.

The folder is $XDG_CACHE_HOME/pattern_gen/maps, ~/.cache/pattern_gen/maps by default; it may be removed at any time.
"""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
from dataclasses import asdict
from enum import Enum
from pathlib import Path
from typing import TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray

from pattern_gen.search_request import Found, Report, Request
from sl_common.files import atomic_path

SEARCH_VERSION = 3  # goes up when a search finds other maps for the same request


def cache_folder() -> Path:
    """Where the maps are kept."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "pattern_gen" / "maps"


class Effort(TypedDict, total=False):
    """What search.search_map is asked for besides the request."""

    rows: int | None
    cols: int | None
    aspect: float
    method: str
    time_limit: float
    start: NDArray[np.uint8] | None


def cached_search(
    request: Request, *, cache: bool = True, report: Report | None = None, **effort: Unpack[Effort]
) -> Found:
    """As search.search_map, but a map that was found before is read instead.

    A map of a given size is the same however long the search took; without a size the time limit decides, too.

    Args:
        cache: False: neither read nor write.

    Raises:
        SearchError: see search_map. A folder that cannot be read or written costs the search, nothing else.
    """
    path = _path(request, effort) if cache else None
    found = None if path is None else _read(path, request.alphabet)
    if found is not None:
        return found
    from pattern_gen.search import search_map  # loads the compiler: only where it is needed

    found = search_map(request, report=report, **effort)
    if path is not None and not found.interrupted:
        try:
            _write(path, found)
        except OSError:
            pass  # a cache that cannot be written is no reason to lose the map
    return found


def _path(request: Request, effort: Effort) -> Path:
    """Where a map is kept: named by a hash of everything that decides what is found."""
    options = {name: value.value if isinstance(value, Enum) else value for name, value in asdict(request).items()}
    options |= {"version": SEARCH_VERSION, "method": effort.get("method", "best")}
    decisive = ("aspect", "time_limit") if effort.get("rows") is None else ("rows", "cols")
    options |= {name: effort.get(name) for name in decisive}
    start = effort.get("start")
    if start is not None:
        options["start"] = [start.shape, hashlib.sha256(np.ascontiguousarray(start).tobytes()).hexdigest()]
    key = hashlib.sha256(json.dumps(options, sort_keys=True).encode()).hexdigest()
    return cache_folder() / f"{key[:32]}.npz"


def _read(path: Path, alphabet: int) -> Found | None:
    """The map in a file; None: there is none, or it is damaged."""
    try:
        with np.load(path, allow_pickle=False) as data:
            symbols = data["symbols"]
            found = Found(symbols, float(data["seconds"]), bool(data["exhausted"]), int(data["steps"]), cached=True)
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile):
        return None
    if symbols.dtype != np.uint8 or symbols.ndim != 2 or symbols.size == 0 or symbols.max() >= alphabet:
        return None
    return found


def _write(path: Path, found: Found) -> None:
    with atomic_path(path) as temporary:
        np.savez_compressed(
            temporary, symbols=found.symbols, seconds=found.seconds, exhausted=found.exhausted, steps=found.steps
        )
