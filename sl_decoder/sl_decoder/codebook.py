"""The code table: all windows of the map in all orientations, sorted, found again by binary search.

Paper, section III.B: "the base 6 strings of all possible codes in all 4 orientations are quicksorted in a preprocessing
step ... found using binary search of the look up table".
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pattern_gen import Grid, Pattern
from sl_common.errors import StructuredLightError
from sl_decoder.compiled import compiled
from sl_decoder.lattice import HEXAGONAL, SQUARE, Lattice, from_axial, to_axial


@dataclass(frozen=True)
class Codebook:
    """The map in axial coordinates and its sorted codes.

    lattice; letters (V, U) int8 letter at axial (u + u_offset, v + v_offset), -1 outside of the map; alphabet;
    map_codes (D, V, U) int64 code of the window around each element, the map turned by so many directions, -1 where
    it is not whole; codes (M,) int64 the same, sorted; values (M, 3) int32 where: axial u and v of the window's
    centre and the orientation, that is the map direction in which the window's direction 0 points.
    """

    lattice: Lattice
    hexagonal: bool
    alphabet: int
    letters: np.ndarray
    v_offset: int
    map_codes: np.ndarray
    codes: np.ndarray
    values: np.ndarray
    rows: int
    cols: int

    def lookup(self, code: int) -> list[tuple[int, int, int]]:
        """(row, col, orientation) of every window with this code."""
        first = int(np.searchsorted(self.codes, code))
        found = []
        while first < len(self.codes) and self.codes[first] == code:
            u, v, k = (int(x) for x in self.values[first])
            row, col = from_axial(np.array(u), np.array(v - self.v_offset), hexagonal=self.hexagonal)
            found.append((int(row), int(col), k))
            first += 1
        return found


def window_code(letters: np.ndarray, alphabet: int) -> int:
    """Code of a window's letters: centre, then the ring by angle, as digits of growing weight."""
    return int(sum(int(letter) * alphabet**place for place, letter in enumerate(letters)))


@compiled
def code_at(cell, centre, width, letter, window, alphabet, member):
    """Code (int64) of the letters (N,) that were read in the window around a cell of a lattice, -1 where a dot lacks.

    cell, width: see `windows.lay_out`; centre: the cell; writes the window's dots: member (W,) int32.
    """
    code = np.int64(0)
    place = np.int64(1)
    for p in range(len(window)):
        dot = cell[centre + window[p, 1] * width + window[p, 0]]
        if dot < 0:
            return np.int64(-1)
        member[p] = dot
        code += letter[dot] * place
        place *= alphabet
    return code


@compiled
def find_code(codes, code):
    """Index of the first entry of the sorted `codes` that equals `code`, or -1."""
    if len(codes) == 0:
        return -1
    low = 0
    left = len(codes)
    while left > 1:  # halves without a branch that depends on the codes
        half = left >> 1
        low += half * np.int64(codes[low + half - 1] < code)
        left -= half
    return low if codes[low] == code else -1


def build_codebook(pattern: Pattern) -> Codebook:
    """Code table of a pattern. Raises StructuredLightError for windows other than 3x3 (or the hexagon)."""
    if pattern.window != 3:
        raise StructuredLightError(
            f"window={pattern.window}: the decoder reads 3x3 windows (or hexagons) only; use window 3"
        )
    hexagonal = pattern.grid is Grid.HEXAGONAL
    lattice = HEXAGONAL if hexagonal else SQUARE
    rows, cols = pattern.rows, pattern.cols
    row, col = np.meshgrid(np.arange(rows), np.arange(cols), indexing="ij")
    u, v = to_axial(row, col, hexagonal=hexagonal)
    v_offset = int(-v.min())
    letters = np.full((int(v.max()) + v_offset + 1, cols), -1, np.int8)
    letters[v + v_offset, u] = pattern.symbols
    padded = np.pad(letters, 1, constant_values=-1)
    size_v, size_u = letters.shape
    stack = np.stack([padded[1 + dv : 1 + dv + size_v, 1 + du : 1 + du + size_u] for du, dv in lattice.window])
    whole = (stack >= 0).all(0)
    centre_v, centre_u = np.nonzero(whole)
    seen = stack[:, centre_v, centre_u].astype(np.int64)
    places = pattern.alphabet ** np.arange(1, len(lattice.window), dtype=np.int64)
    map_codes = np.full((lattice.directions, *letters.shape), -1, np.int64)
    codes, values = [], []
    for k in range(lattice.directions):
        ring = np.roll(seen[1:], -k * lattice.ring_shift, axis=0)
        codes.append(seen[0] + (ring * places[:, None]).sum(0))
        map_codes[k, centre_v, centre_u] = codes[k]
        values.append(np.stack([centre_u, centre_v, np.full_like(centre_u, k)], 1))
    flat = np.concatenate(codes)
    order = np.argsort(flat, kind="stable")
    return Codebook(
        lattice=lattice,
        hexagonal=hexagonal,
        alphabet=pattern.alphabet,
        letters=letters,
        v_offset=v_offset,
        map_codes=map_codes,
        codes=flat[order],
        values=np.concatenate(values)[order].astype(np.int32),
        rows=rows,
        cols=cols,
    )
