import numpy as np
import pytest
from brute_force import least_distances

from pattern_gen.best import LineByLine, searchers
from pattern_gen.line_search import LineSearch
from pattern_gen.near_lines import free_triples, make_stored, push_line
from pattern_gen.packing import packing
from pattern_gen.pattern import Grid
from pattern_gen.search_request import Reading, Request
from pattern_gen.windows import window_geometry


@pytest.mark.parametrize("h", [2, 3, 5])
@pytest.mark.parametrize("alphabet", [2, 3, 6])
def test_the_free_triples_are_those_that_brute_force_leaves(alphabet, h):
    random = np.random.default_rng(alphabet + h)
    geometry, pack = window_geometry(Grid.SQUARE), packing(alphabet, 9)
    stored = make_stored(4, 6, alphabet, h, 4, 50.0)
    bits = int(pack[0])
    windows = random.integers(0, alphabet, (2, 4, 9))
    turned = windows[:, :, geometry.rotations].reshape(2, 16, 9)
    for line in (2, 3):
        stored.codes[line] = (turned[line - 2].astype(np.uint64) << (bits * np.arange(9)).astype(np.uint64)).sum(axis=1)
        push_line(stored, line)
    assert not stored.overflow[0]
    for _ in range(10):
        six = random.integers(0, alphabet, 6)
        free = np.zeros(len(stored.every), np.uint64)
        top = np.uint64((six << (bits * np.arange(6))).sum())
        some = free_triples(stored, pack, h, top, free)
        triples = np.stack(np.unravel_index(np.arange(alphabet**3), (alphabet,) * 3), axis=1)
        whole = np.concatenate([np.broadcast_to(six, (len(triples), 6)), triples], axis=1)
        expected = ((whole[:, None] != turned.reshape(1, -1, 9)).sum(axis=2) >= h).all(axis=1)
        found = np.unpackbits(free.view(np.uint8), bitorder="little")[: alphabet**3].astype(bool)
        assert np.array_equal(found, expected)
        assert some == expected.any()


@pytest.mark.parametrize("reading", list(Reading))
@pytest.mark.parametrize(("alphabet", "h", "rows", "cols", "invariant"), [(5, 3, 14, 18, True), (4, 2, 12, 20, False)])
def test_its_maps_hold_by_brute_force(alphabet, h, rows, cols, invariant, reading):
    request = Request(alphabet=alphabet, h=h, reading=reading, invariant=invariant)
    search = LineByLine(request, rows, cols, 3, 0.5)
    assert search.run(3_000_000)
    symbols = search.result()
    assert symbols.shape == (rows, cols)
    between, own = least_distances(symbols, False, rotations=invariant)
    assert between >= h
    assert own >= request.own


def test_it_finds_large_maps_beyond_the_depth_first_search():
    search = LineSearch(43, 32, alphabet=5, h=3, own=1, turns=4, seed=0, falling=0.5, candidates=20)
    assert search.run(3_000_000)


def test_full_buckets_are_made_larger():
    search = LineSearch(12, 10, alphabet=6, h=3, own=1, turns=4, seed=0, falling=0.05, candidates=1)
    search._spare = 0.1
    search._restart()
    done = [search.run(5_000) for _ in range(40)]
    assert search._spare > 0.1
    assert search.deepest > 2
    assert any(done)


def test_what_is_found_does_not_depend_on_the_slices():
    """A slow machine takes the same steps in more slices."""
    request = Request(alphabet=4, h=3, seed=5)
    for make in searchers(request, 14, 18):
        ends = []
        for slices in (1, 7, 50):
            kind = make()
            end = 40_000
            while kind.steps < end and not kind.run(min(-(-end // slices), end - kind.steps)):
                pass
            ends.append((kind.steps, kind.filled))
        assert ends[0] == ends[1] == ends[2]
