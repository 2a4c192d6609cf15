import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pattern_gen import Grid, Letter, Pattern, default_pattern
from pattern_gen.errors import PatternError, PatternFileError
from pattern_gen.letters import choose_letters, default_letters, intensity_drives
from pattern_gen.pattern import fit_to_projector


def small(alphabet=3, shape=(5, 6), **options):
    symbols = np.random.default_rng(1).integers(0, alphabet, shape).astype(np.uint8)
    symbols[0, :alphabet] = np.arange(alphabet)
    return fit_to_projector(symbols, choose_letters(alphabet), **options)


def test_default_pattern_is_the_papers_size_and_alphabet():
    pattern = default_pattern()
    assert (pattern.rows, pattern.cols, pattern.alphabet, pattern.min_hamming) == (44, 58, 6, 3)
    assert (pattern.projector_width, pattern.projector_height) == (1024, 768)
    assert pattern.letters == default_letters()
    assert pattern.window_count == 2352


def test_two_intensities_differ_in_light_but_stay_visible():
    bright, dark = intensity_drives(2)
    assert bright == 255
    assert 0.2 < (dark / 255) ** 2.2 < 0.35


def test_id_is_of_the_content_not_of_the_size_of_spots_or_the_projector():
    pattern = small()
    assert pattern.with_spot_diameter(3.0).pattern_id == pattern.pattern_id
    assert fit_to_projector(pattern.symbols, pattern.letters, projector_width=640).pattern_id == pattern.pattern_id
    other = pattern.symbols.copy()
    other[2, 2] = (other[2, 2] + 1) % 3
    assert fit_to_projector(other, pattern.letters).pattern_id != pattern.pattern_id
    assert pattern.with_letters(choose_letters(3, monochrome=True)).pattern_id != pattern.pattern_id


def test_hexagonal_centres_have_six_neighbours_at_one_pitch():
    pattern = small(shape=(5, 6), grid=Grid.HEXAGONAL)
    centers = pattern.centers.reshape(-1, 2)
    gap = np.linalg.norm(centers - pattern.centers[2, 3], axis=1)
    assert np.sum(np.abs(gap - pattern.pitch) < 1e-9) == 6
    assert np.sort(gap)[7] > 1.5 * pattern.pitch


@pytest.mark.parametrize("grid", list(Grid))
@pytest.mark.parametrize("size", [(1024, 768), (640, 480), (1920, 1080)])
def test_fitted_pattern_is_centred_and_inside(grid, size):
    pattern = small(shape=(20, 30), grid=grid, projector_width=size[0], projector_height=size[1])
    low, high = pattern.centers.min(axis=(0, 1)), pattern.centers.max(axis=(0, 1))
    assert np.allclose(low + high, np.array(size) - 1, atol=2e-3)
    assert (low >= 0.5 * pattern.pitch - 1).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"window": 4}, "window=4"),
        ({"min_hamming": 0}, "min_hamming=0"),
        ({"pitch": -1.0}, "pitch=-1.0"),
        ({"spot_diameter": float("nan")}, "spot_diameter"),
        ({"pitch": 400.0}, "outside the projector image"),
        ({"letters": choose_letters(2)}, "symbol 2"),
        ({"letters": (Letter((9, 9, 9)),) * 3}, "same representation"),
    ],
)
def test_contradictions_are_refused_with_the_numbers(change, words):
    good = small()
    fields = {name: getattr(good, name) for name in good.__dataclass_fields__}
    with pytest.raises(PatternError, match=words):
        Pattern(**fields | change)


@pytest.mark.parametrize(("rgb", "shape"), [((0, 0, 0), "disc"), ((256, 0, 0), "disc"), ((9, 9, 9), "star")])
def test_bad_letters_are_refused(rgb, shape):
    with pytest.raises(PatternError):
        Letter(rgb, shape)


@pytest.mark.parametrize("count", range(2, 37))
@pytest.mark.parametrize("monochrome", [False, True])
def test_every_alphabet_has_distinct_representations(count, monochrome):
    letters = choose_letters(count, monochrome=monochrome)
    assert len(set(letters)) == count
    if monochrome:
        assert all(len(set(letter.rgb)) == 1 for letter in letters)


@settings(max_examples=40, deadline=None)
@given(
    grid=st.sampled_from(list(Grid)),
    alphabet=st.integers(2, 36),
    shape=st.tuples(st.integers(3, 9), st.integers(3, 9)),
    seed=st.integers(0, 1000),
    h=st.integers(1, 5),
)
def test_file_gives_back_what_was_saved(tmp_path_factory, grid, alphabet, shape, seed, h):
    symbols = np.random.default_rng(seed).integers(0, alphabet, shape).astype(np.uint8)
    pattern = fit_to_projector(symbols, choose_letters(alphabet), grid=grid, min_hamming=h, projector_width=800)
    path = tmp_path_factory.mktemp("files") / "pattern.yaml"
    pattern.save(path)
    again = Pattern.load(path)
    assert again.pattern_id == pattern.pattern_id
    assert np.array_equal(again.symbols, pattern.symbols)
    assert again.letters == pattern.letters
    assert np.array_equal(again.centers, pattern.centers)
    assert again.spot_diameter == pattern.spot_diameter


GOOD = """grid: square
window: 3
min_hamming: 1
projector: {width: 640, height: 480}
pitch: 20.0
origin: [30.0, 30.0]
spot_diameter: 9.0
letters:
- rgb: [255, 0, 0]
  shape: disc
- rgb: [0, 255, 0]
  shape: ring
rows:
- "0101"
- 0011
- "1010"
"""


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("grid: square", "grid: round", 1, "round"),
        ("window: 3", "window: 4", 2, "odd"),
        ("min_hamming: 1", "min_hamming: x", 3, "integer"),
        ("width: 640", "width: 0", 4, "from 1"),
        ("width: 640, ", "", 4, "lacks width"),
        ("pitch: 20.0", "pitch: -2", 5, "above 0"),
        ("origin: [30.0, 30.0]", "origin: [30.0]", 6, "2 values"),
        ("spot_diameter: 9.0", "spot_diameter: .nan", 7, "spot_diameter"),
        ("[0, 255, 0]", "[0, 256, 0]", 11, "255"),
        ("shape: ring", "shape: blob", 11, "blob"),
        ('"0101"', '"0121"', 14, "row 0, column 2: symbol '2'"),
        ('"1010"', '"101"', 16, "3 symbols"),
        ("pitch: 20.0", "pitch: 20.0\nsurplus: 1", 6, "unknown key 'surplus'"),
        ("window: 3", "window: 3\nwindow: 3", 3, "twice"),
        ("rows:", "rows: [", None, "YAML"),
        ("pitch: 20.0", "pitch: 500.0", 5, "outside the projector"),
    ],
)
def test_bad_files_are_refused_with_line_and_reason(tmp_path, old, new, line, words):
    path = tmp_path / "bad.yaml"
    assert old in GOOD
    path.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(PatternFileError) as error:
        Pattern.load(path)
    assert words in str(error.value)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)
    if line is not None:
        assert error.value.line == line


def test_good_file_loads_also_with_unquoted_rows(tmp_path):
    path = tmp_path / "good.yaml"
    path.write_text(GOOD)
    assert Pattern.load(path).symbols.tolist() == [[0, 1, 0, 1], [0, 0, 1, 1], [1, 0, 1, 0]]


@pytest.mark.parametrize("text", ["", "- 1\n", "\x00", "a: [1\n"])
def test_other_texts_are_refused(tmp_path, text):
    path = tmp_path / "other.yaml"
    path.write_text(text)
    with pytest.raises(PatternFileError):
        Pattern.load(path)
    with pytest.raises(PatternFileError, match="no such file"):
        Pattern.load(tmp_path / "missing.yaml")
