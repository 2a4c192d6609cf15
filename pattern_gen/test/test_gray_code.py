import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pattern_gen import charts
from pattern_gen.errors import ProjectionError
from pattern_gen.gray_code import Arrangement, Axis, bit_count, code_frame, code_words, decode_words


def distances(words):
    return np.array([int(a ^ b).bit_count() for a, b in itertools.pairwise(words)])


@pytest.mark.parametrize("arrangement", Arrangement)
@given(length=st.integers(2, 3000))
def test_words_are_distinct_and_decode_to_their_index(arrangement, length):
    words = code_words(length, arrangement)
    assert len(set(words.tolist())) == length
    assert words.max() < 1 << bit_count(length)
    assert np.array_equal(decode_words(words, length, arrangement), np.arange(length))


@given(st.integers(3, 3000))
def test_consecutive_words_differ_least_or_most(length):
    bits = bit_count(length)
    assert set(distances(code_words(length, Arrangement.REFLECTED))) == {1}
    assert set(distances(code_words(length, Arrangement.MAX_DISTANCE))) <= {bits, bits - 1}


def test_unused_words_decode_to_nothing():
    assert decode_words(np.array([1023]), 768, Arrangement.REFLECTED).tolist() in ([-1], [682])
    used = code_words(768)
    unused = np.setdiff1d(np.arange(1024), used)
    assert (decode_words(unused, 768) == -1).all()


@pytest.mark.parametrize(("axis", "length"), [(Axis.COLUMNS, 40), (Axis.ROWS, 24)])
@pytest.mark.parametrize("arrangement", Arrangement)
def test_frames_and_their_inverses_spell_every_pixel_s_word(axis, length, arrangement):
    bits = bit_count(length)
    words = np.zeros((24, 40), dtype=np.int64)
    for bit in range(bits):
        frame = code_frame(40, 24, axis, bit, arrangement=arrangement)
        inverse = code_frame(40, 24, axis, bit, inverse=True, arrangement=arrangement)
        assert (frame + inverse == 255).all()
        words = words << 1 | (frame[..., 0] > inverse[..., 0])
    index = np.arange(40)[None, :] if axis is Axis.COLUMNS else np.arange(24)[:, None]
    assert np.array_equal(decode_words(words, length, arrangement), np.broadcast_to(index, (24, 40)))


def test_frames_that_do_not_exist_are_refused_with_the_range():
    with pytest.raises(ProjectionError, match=r"bit 10 does not exist: the 1024 columns take 10 bits, 0 to 9"):
        code_frame(1024, 768, Axis.COLUMNS, 10)
    with pytest.raises(ProjectionError, match="the colour chart has 28 frames"):
        charts.colour_chart(64, 48, 28)
    with pytest.raises(ProjectionError, match="channel 3 does not exist"):
        charts.intensity_chart(64, 48, 3, 0)


def test_over_all_frames_every_place_of_the_chart_sees_every_colour():
    drives = charts.colour_chart_drives()
    seen = np.stack([charts.colour_chart_values(k) for k in range(len(drives))])
    for place in np.ndindex(charts.CHART_ROWS, charts.CHART_COLS):
        assert len({tuple(v) for v in seen[(slice(None), *place)]}) == len({tuple(v) for v in drives})
