"""Slow and obvious reference implementations: windows by geometry, distances by comparing every pair."""

import math

import numpy as np


def position(hexagonal, row, col):
    return (col * math.sqrt(3) / 2, row + 0.5 * (col % 2)) if hexagonal else (float(col), float(row))


def windows(symbols, hexagonal):
    """{(row, col): {rounded (x, y) relative to the centre: symbol}} of all whole 3x3 windows or hexagons."""
    rows, cols = symbols.shape
    reach = 1.01 if hexagonal else 1.5
    size = 7 if hexagonal else 9
    result = {}
    for row in range(rows):
        for col in range(cols):
            x0, y0 = position(hexagonal, row, col)
            cells = {}
            for r in range(max(row - 2, 0), min(row + 3, rows)):
                for c in range(max(col - 2, 0), min(col + 3, cols)):
                    x, y = position(hexagonal, r, c)
                    if math.hypot(x - x0, y - y0) < reach:
                        cells[(round(x - x0, 3) + 0.0, round(y - y0, 3) + 0.0)] = int(symbols[r, c])
            if len(cells) == size:
                result[(row, col)] = cells
    return result


def turned(cells, angle):
    c, s = math.cos(angle), math.sin(angle)
    return {(round(c * x - s * y, 3) + 0.0, round(s * x + c * y, 3) + 0.0): value for (x, y), value in cells.items()}


def lookup(cells, key):
    return min(cells.items(), key=lambda item: math.dist(item[0], key))[1]


def distance(first, second):
    return sum(value != lookup(second, key) for key, value in first.items())


def least_distances(symbols, hexagonal, rotations=True):
    """Least distance between different windows, and of a window from its own rotations (over all rotations)."""
    count = (6 if hexagonal else 4) if rotations else 1
    all_windows = list(windows(symbols, hexagonal).items())
    between = own = 99
    for k in range(count):
        rotated = [turned(cells, 2 * math.pi * k / count) for _, cells in all_windows]
        for i, (_, cells) in enumerate(all_windows):
            for j, other in enumerate(rotated):
                if i != j:
                    between = min(between, distance(cells, other))
                elif k:
                    own = min(own, distance(cells, other))
    return between, own


def centroid(image, u, v, reach):
    """Centroid of a rendered spot's light, from the pixels within `reach` of its centre."""
    u0, v0 = round(u), round(v)
    top, left = max(v0 - reach, 0), max(u0 - reach, 0)
    part = image[top : v0 + reach + 1, left : u0 + reach + 1].astype(float).sum(axis=2)
    rows, cols = np.mgrid[top : top + part.shape[0], left : left + part.shape[1]]
    return (part * cols).sum() / part.sum(), (part * rows).sum() / part.sum()
