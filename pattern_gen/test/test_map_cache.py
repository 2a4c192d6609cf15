import os
import stat

import numpy as np
import pytest

from pattern_gen import generate, search
from pattern_gen.errors import SearchError
from pattern_gen.map_cache import cache_folder, cached_search
from pattern_gen.search_request import Request

REQUEST = Request(alphabet=5, h=3, seed=4)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "pattern_gen" / "maps"


def test_a_map_is_searched_once(folder, monkeypatch):
    first = cached_search(REQUEST, rows=10, cols=12)
    assert not first.cached
    assert [path.suffix for path in folder.iterdir()] == [".npz"]
    monkeypatch.setattr(search, "search_map", lambda *_, **__: pytest.fail("searched again"))
    again = cached_search(REQUEST, rows=10, cols=12, time_limit=99.0)
    assert again.cached
    assert np.array_equal(again.symbols, first.symbols)
    assert again.steps == first.steps


@pytest.mark.parametrize(
    ("request_", "options"),
    [
        (Request(alphabet=5, h=3, seed=5), {}),
        (Request(alphabet=6, h=3, seed=4), {}),
        (Request(alphabet=5, h=2, seed=4), {}),
        (Request(alphabet=5, h=3, seed=4, reading="base"), {}),
        (REQUEST, {"rows": 11}),
        (REQUEST, {"method": "paper"}),
        (REQUEST, {"start": np.array([[0, 1, 2], [3, 4, 0], [1, 1, 3]], np.uint8)}),
    ],
)  # fmt: skip
def test_other_requests_are_searched(folder, request_, options):
    from pattern_gen.search_request import Reading

    if isinstance(request_.reading, str):
        request_ = Request(alphabet=5, h=3, seed=4, reading=Reading(request_.reading))
    cached_search(REQUEST, rows=10, cols=12)
    assert not cached_search(request_, **{"rows": 10, "cols": 12} | options).cached


def test_without_a_size_the_time_limit_counts(folder):
    cached_search(REQUEST, time_limit=0.2)
    assert not cached_search(REQUEST, time_limit=0.3).cached
    assert cached_search(REQUEST, time_limit=0.2).cached


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 not a zip", None])
def test_damaged_files_are_searched_again(folder, damage):
    first = cached_search(REQUEST, rows=10, cols=12)
    (path,) = folder.iterdir()
    if damage is None:  # letters out of the alphabet
        np.savez(path, symbols=np.full((10, 12), 9, np.uint8), seconds=0.0, exhausted=False, steps=1)
    else:
        path.write_bytes(damage)
    again = cached_search(REQUEST, rows=10, cols=12)
    assert not again.cached
    assert np.array_equal(again.symbols, first.symbols)
    assert cached_search(REQUEST, rows=10, cols=12).cached


def test_no_cache_reads_and_writes_nothing(folder):
    generate(5, 3, rows=10, cols=12, cache=False)
    assert not folder.exists()
    generate(5, 3, rows=10, cols=12)
    assert len(list(folder.iterdir())) == 1


def test_an_unusable_folder_costs_nothing_but_the_search(tmp_path, monkeypatch):
    file = tmp_path / "file"
    file.write_text("")
    file.chmod(stat.S_IRUSR)
    monkeypatch.setenv("XDG_CACHE_HOME", str(file))
    assert cached_search(REQUEST, rows=10, cols=12).size == (10, 12)
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    assert os.path.isabs(cache_folder())
    assert "relative" not in str(cache_folder())


def test_failed_and_interrupted_searches_are_not_kept(folder):
    with pytest.raises(SearchError):
        cached_search(REQUEST, rows=200, cols=200)

    def interrupt(progress):
        if progress.best is not None:
            raise KeyboardInterrupt

    assert cached_search(REQUEST, report=interrupt).interrupted
    assert not folder.exists()
