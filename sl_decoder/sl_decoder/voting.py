"""The paper's voting (section III.B), which corrects a single wrong letter per window.

"If a code is found in the LUT, then the score for all elements of the code in the observed colour is increased by 9 ...
If the code is not found, then for each of the 9 elements we try to find a valid code by changing only one of the
elements ... If such code can be found, we increase the score for that colour of that spot by one. Then we assign the
colour to the spot that has the highest vote."  In general the weight of a found code is the number of elements of a
window: one for each hypothesis that one of them is wrong.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.codebook import code_at, find_code
from sl_decoder.compiled import compiled


@compiled
def vote(cell, at, width, letter, window, alphabet, codes):
    """Scores (N, A) int32 of the letters of N dots on their lattices.

    cell, at, width: the layout of `windows.lay_out`; letter (N,) int32 as read; window (W, 2) int32 offsets; codes
    (M,) int64 sorted code table.
    """
    n = len(at)
    size = len(window)
    score = np.zeros((n, alphabet), np.int32)
    member = np.empty(size, np.int32)
    for i in range(n):
        if at[i] < 0:
            continue
        code = code_at(cell, at[i], width[i], letter, window, alphabet, member)
        if code < 0:
            continue
        if find_code(codes, code) >= 0:
            for p in range(size):
                score[member[p], letter[member[p]]] += size
            continue
        place = np.int64(1)
        for p in range(size):
            j = member[p]
            for a in range(alphabet):
                if a != letter[j] and find_code(codes, code + (a - letter[j]) * place) >= 0:
                    score[j, a] += 1
            place *= alphabet
    return score


@compiled
def elect(score, letter):
    """Letters (N,) int32 with the highest vote; where none has more than the letter that was read, that one stays."""
    out = letter.copy()
    for i in range(len(letter)):
        for a in range(score.shape[1]):
            if score[i, a] > score[i, out[i]]:
                out[i] = a
    return out
