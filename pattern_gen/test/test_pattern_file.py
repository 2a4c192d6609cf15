import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from pattern_gen import Grid, Letter, Pattern, default_pattern
from pattern_gen.errors import PatternError, PatternFileError
from pattern_gen.letters import choose_letters
from pattern_gen.pattern import fit_to_projector


@st.composite
def patterns(draw):
    alphabet = draw(st.integers(2, 36))
    rows, cols = draw(st.integers(3, 9)), draw(st.integers(3, 9))
    symbols = draw(st.lists(st.integers(0, alphabet - 1), min_size=rows * cols, max_size=rows * cols))
    grid = draw(st.sampled_from(Grid))
    return fit_to_projector(np.reshape(symbols, (rows, cols)), choose_letters(alphabet), grid=grid)


@given(patterns())
def test_a_saved_pattern_loads_as_it_was(tmp_path_factory, pattern):
    path = tmp_path_factory.mktemp("patterns") / "pattern.yaml"
    pattern.save(path)
    loaded = Pattern.load(path)
    assert loaded.pattern_id == pattern.pattern_id
    assert np.array_equal(loaded.symbols, pattern.symbols)
    assert np.array_equal(loaded.centers, pattern.centers)
    assert (loaded.letters, loaded.grid, loaded.spot_diameter) == (pattern.letters, pattern.grid, pattern.spot_diameter)


def test_the_file_has_the_documented_keys(tmp_path):
    default_pattern().save(tmp_path / "pattern.yaml")
    data = yaml.safe_load((tmp_path / "pattern.yaml").read_text())
    assert list(data) == [
        "grid",
        "window",
        "min_hamming",
        "projector",
        "pitch",
        "origin",
        "spot_diameter",
        "letters",
        "rows",
    ]
    assert len(data["rows"]) == 44
    assert {len(row) for row in data["rows"]} == {58}


VALID = """\
grid: square
window: 3
min_hamming: 1
projector: {width: 100, height: 100}
pitch: 20.0
origin: [10.0, 10.0]
spot_diameter: 9.0
letters:
- {rgb: [255, 0, 0], shape: disc}
- {rgb: [0, 255, 0], shape: disc}
rows: ["0101", "0011", "1101", "0110"]
"""


def test_the_template_of_the_next_test_is_valid(tmp_path):
    (tmp_path / "p.yaml").write_text(VALID)
    assert Pattern.load(tmp_path / "p.yaml").rows == 4


@pytest.mark.parametrize(
    ("old", "new", "line", "reason"),
    [
        ("grid: square", "grid: triangular", 1, "it must be square or hexagonal"),
        ("window: 3", "window: 4", 2, "it must be odd"),
        ("min_hamming: 1", "min_hamming: none", 3, "must be an integer"),
        ("min_hamming: 1\n", "", 1, "lacks min_hamming"),
        ("pitch: 20.0", "pitch: -1", 5, "it must be above 0"),
        ("pitch: 20.0", "pitch: 200.0", 5, "lies outside the projector image"),
        ("origin: [10.0, 10.0]", "origin: [10.0]", 6, "must have 2 values, not 1"),
        ("spot_diameter: 9.0", "spot_diameter: .nan", 7, "must be a number"),
        ("rgb: [255, 0, 0]", "rgb: [256, 0, 0]", 9, "it must be from 0 to 255"),
        ("rgb: [0, 255, 0]", "rgb: [0, 0, 0]", 10, "is black"),
        ("rgb: [0, 255, 0]", "rgb: [255, 0, 0]", 10, "looks like letter 0"),
        ("shape: disc}\nrows", "shape: star}\nrows", 10, "unknown shape 'star'"),
        ('"0011"', '"0012"', 11, "row 1, column 3: symbol '2' is not one of the 2 letters"),
        ('"0011"', '"001"', 11, "row 1 has 3 symbols, row 0 has 4"),
        ('"0011"', '"00+1"', 11, "symbol '\\+' is not one"),
        ("rows:", "colour: blue\nrows:", 11, "unknown key 'colour'"),
        ("grid: square", "grid: [square", 2, "not valid YAML"),
    ],
)
def test_invalid_files_are_refused_with_line_and_reason(tmp_path, old, new, line, reason):
    path = tmp_path / "p.yaml"
    assert old in VALID
    path.write_text(VALID.replace(old, new, 1))
    with pytest.raises(PatternFileError, match=reason) as error:
        Pattern.load(path)
    assert str(path) in str(error.value)
    assert f"line {line}" in str(error.value) or f":{line}:" in str(error.value)


@pytest.mark.parametrize("content", [None, b"", b"\xff\xfe\x00bad", b"- 1\n- 2\n"])
def test_files_that_are_no_pattern_at_all_are_refused(tmp_path, content):
    path = tmp_path / "p.yaml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(PatternFileError, match=r"p\.yaml"):
        Pattern.load(path)


def test_the_id_names_the_content_and_not_its_size_on_the_screen():
    pattern = default_pattern()
    assert pattern.with_spot_diameter(5.0).pattern_id == pattern.pattern_id
    other = np.array(pattern.symbols)
    other[20, 30] = (other[20, 30] + 1) % 6
    assert Pattern(pattern.grid, other, pattern.letters).pattern_id != pattern.pattern_id
    letters = (Letter((250, 0, 0)), *pattern.letters[1:])
    assert pattern.with_letters(letters).pattern_id != pattern.pattern_id


def test_patterns_that_contradict_themselves_are_refused():
    letters = choose_letters(2)
    with pytest.raises(PatternError, match="symbol 2 at row 1, column 1 has no letter"):
        fit_to_projector([[0, 1, 0], [1, 2, 0], [0, 0, 0]], letters)
    with pytest.raises(PatternError, match="holds no 3x3 window"):
        fit_to_projector(np.zeros((2, 9)), letters)
    with pytest.raises(PatternError, match="same representation"):
        fit_to_projector(np.zeros((3, 3)), (letters[0], letters[0]))
