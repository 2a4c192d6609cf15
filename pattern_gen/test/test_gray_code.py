import numpy as np
import pytest

from pattern_gen.catalogue import default_pattern
from pattern_gen.charts import (
    colour_chart,
    colour_chart_drives,
    colour_chart_values,
    intensity_chart,
    intensity_levels,
)
from pattern_gen.errors import ProjectionError
from pattern_gen.gray_code import Arrangement, Axis, bit_count, code_frame, code_words, decode_words
from pattern_gen.projection import FrameRequest, Mode, SpotLimits, adapted_diameter, render_frame


def bits_set(values):
    return np.array([int(value).bit_count() for value in values])


@pytest.mark.parametrize("length", [2, 3, 7, 8, 768, 1024, 1280, 1920])
@pytest.mark.parametrize("arrangement", list(Arrangement))
def test_words_are_unique_and_decode_to_their_place(length, arrangement):
    words = code_words(length, arrangement)
    assert len(set(words.tolist())) == length
    assert words.max() < 1 << bit_count(length)
    assert np.array_equal(decode_words(words, length, arrangement), np.arange(length))


@pytest.mark.parametrize("length", [8, 768, 1024])
def test_distances_of_consecutive_words(length):
    bits = bit_count(length)
    reflected = code_words(length, Arrangement.REFLECTED)
    assert (bits_set(reflected[1:] ^ reflected[:-1]) == 1).all()
    far = code_words(length, Arrangement.MAX_DISTANCE)
    steps = bits_set(far[1:] ^ far[:-1])
    assert (steps[::2] == bits).all()
    # twice n in a row would repeat a word, so n and n - 1 in turn is the most there can be
    assert (steps[1::2] == bits - 1).all()


def test_unused_words_decode_to_none():
    assert (decode_words(np.arange(1024), 768) == -1).sum() == 1024 - 768


@pytest.mark.parametrize("axis", list(Axis))
@pytest.mark.parametrize("arrangement", list(Arrangement))
def test_frames_with_their_inverses_give_back_the_columns_and_rows(axis, arrangement):
    width, height = 100, 60
    length = width if axis is Axis.COLUMNS else height
    word = np.zeros((height, width), np.int64)
    for bit in range(bit_count(length)):
        frame = code_frame(width, height, axis, bit, arrangement=arrangement)
        inverse = code_frame(width, height, axis, bit, inverse=True, arrangement=arrangement)
        assert frame.shape == (height, width, 3)
        assert (frame.astype(int) + inverse == 255).all()
        word = word * 2 + (frame[..., 0] > inverse[..., 0])
    place = decode_words(word, length, arrangement)
    rows, cols = np.mgrid[:height, :width]
    assert np.array_equal(place, cols if axis is Axis.COLUMNS else rows)


def test_frames_that_do_not_exist_are_refused():
    with pytest.raises(ProjectionError, match="bit 7"):
        code_frame(100, 60, Axis.COLUMNS, 7)
    with pytest.raises(ProjectionError, match="channel 3"):
        intensity_chart(10, 10, 3, 0)
    with pytest.raises(ProjectionError, match="step 99"):
        intensity_chart(10, 10, 0, 99)
    with pytest.raises(ProjectionError, match="step 28"):
        colour_chart(10, 10, 28)


def test_every_place_of_the_colour_chart_sees_every_value():
    steps = [colour_chart_values(step) for step in range(len(colour_chart_drives()))]
    for row in range(steps[0].shape[0]):
        for col in range(steps[0].shape[1]):
            assert len({tuple(values[row, col]) for values in steps}) == len(steps)
    image = colour_chart(700, 400, 5)
    assert tuple(image[50, 50]) == tuple(steps[5][0, 0])
    assert tuple(image[399, 699]) == tuple(steps[5][-1, -1])


def test_intensity_chart_rises_in_one_channel():
    frames = [intensity_chart(4, 3, 1, step) for step in range(len(intensity_levels()))]
    levels = [int(frame[0, 0, 1]) for frame in frames]
    assert levels[0] == 0
    assert levels[-1] == 255
    assert levels == sorted(set(levels))
    assert all(not frame[..., [0, 2]].any() for frame in frames)


def test_frames_by_mode():
    pattern = default_pattern()
    for mode, value in ((Mode.WHITE, 255), (Mode.BLACK, 0)):
        image, frames, _ = render_frame(pattern, FrameRequest(mode=mode))
        assert frames == 1
        assert (image == value).all()
    image, frames, _ = render_frame(pattern, FrameRequest(mode=Mode.GRAY_CODE, axis=Axis.ROWS))
    assert frames == 10
    image, _, _ = render_frame(pattern, FrameRequest(mode=Mode.PATTERN))
    assert np.array_equal(image, pattern.render())


def test_spots_are_adapted_to_the_cameras_view_within_the_limits():
    pattern, limits = default_pattern(), SpotLimits()
    assert adapted_diameter(pattern, 12.0, 2.0, limits) == pytest.approx(6.0)
    assert adapted_diameter(pattern, 100.0, 2.0, limits) == pytest.approx(0.75 * pattern.pitch)
    assert adapted_diameter(pattern, 1.0, 2.0, limits) == pytest.approx(2.0)
    for bad in (0.0, -1.0, float("nan")):
        with pytest.raises(ProjectionError):
            adapted_diameter(pattern, 8.0, bad, limits)
