"""The pattern file: YAML with one string of base-36 digits a row. Refused with the line and the reason when invalid."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from pattern_gen.errors import PatternError, PatternFileError
from pattern_gen.pattern import Grid, Letter, Pattern
from sl_common.files import write_text

DIGITS = "0123456789abcdefghijklmnopqrstuvwxyz"
KEYS = ("grid", "window", "min_hamming", "projector", "pitch", "origin", "spot_diameter", "letters", "rows")
_VALUE_OF_BYTE = np.full(256, 255, dtype=np.uint8)
for _value, _digit in enumerate(DIGITS):
    _VALUE_OF_BYTE[ord(_digit)] = _VALUE_OF_BYTE[ord(_digit.upper())] = _value
_BYTE_OF_VALUE = np.frombuffer(DIGITS.encode(), dtype=np.uint8)
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _Reader:
    """Reads values off YAML nodes, which know their lines."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def fail(self, node: yaml.Node | None, reason: str) -> PatternFileError:
        return PatternFileError(self.path, None if node is None else node.start_mark.line + 1, reason)

    def mapping(self, node: yaml.Node, what: str, keys: tuple[str, ...]) -> dict[str, yaml.Node]:
        if not isinstance(node, yaml.MappingNode):
            raise self.fail(node, f"{what} must be a mapping with the keys {', '.join(keys)}")
        found: dict[str, yaml.Node] = {}
        for key, value in node.value:
            if key.value not in keys:
                raise self.fail(key, f"unknown key {key.value!r} in {what}; known: {', '.join(keys)}")
            if key.value in found:
                raise self.fail(key, f"key {key.value!r} is given twice in {what}")
            found[key.value] = value
        missing = [key for key in keys if key not in found]
        if missing:
            raise self.fail(node, f"{what} lacks {', '.join(missing)}")
        return found

    def sequence(self, node: yaml.Node, what: str, length: int | None = None) -> list[yaml.Node]:
        if not isinstance(node, yaml.SequenceNode):
            raise self.fail(node, f"{what} must be a list")
        if length is not None and len(node.value) != length:
            raise self.fail(node, f"{what} must have {length} values, not {len(node.value)}")
        return list(node.value)

    def text(self, node: yaml.Node, what: str) -> str:
        if not isinstance(node, yaml.ScalarNode):
            raise self.fail(node, f"{what} must be a single value")
        return str(node.value)

    def number(self, node: yaml.Node, what: str, minimum: float = -np.inf, above: float = -np.inf) -> float:
        text = self.text(node, what)
        try:
            value = float(text)
        except ValueError:
            raise self.fail(node, f"{what} must be a number, not {text!r}") from None
        if not np.isfinite(value) or value < minimum or value <= above:
            limit = f"at least {minimum:g}" if np.isfinite(minimum) else f"above {above:g}"
            wanted = "finite" if np.isinf(minimum) and np.isinf(above) else limit
            raise self.fail(node, f"{what} is {text}, it must be {wanted}")
        return value

    def integer(self, node: yaml.Node, what: str, minimum: int, maximum: int = 2**31 - 1) -> int:
        text = self.text(node, what)
        try:
            value = int(text)
        except ValueError:
            raise self.fail(node, f"{what} must be an integer, not {text!r}") from None
        if not minimum <= value <= maximum:
            raise self.fail(node, f"{what} is {value}, it must be from {minimum} to {maximum}")
        return value


def _compose(path: Path) -> yaml.Node:
    try:
        with path.open(encoding="utf-8") as stream:
            node = yaml.compose(stream, Loader=_Loader)
    except FileNotFoundError:
        raise PatternFileError(path, None, "no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise PatternFileError(path, None, f"cannot be read: {error}") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = None if mark is None else mark.line + 1
        raise PatternFileError(path, line, f"not valid YAML: {getattr(error, 'problem', error)}") from None
    if node is None:
        raise PatternFileError(path, 1, "the file is empty")
    return node


def _read_letters(reader: _Reader, node: yaml.Node) -> tuple[Letter, ...]:
    letters: list[Letter] = []
    entries = reader.sequence(node, "letters")
    if not 2 <= len(entries) <= len(DIGITS):
        raise reader.fail(node, f"letters has {len(entries)} entries; an alphabet has 2 to {len(DIGITS)}")
    for number, entry in enumerate(entries):
        what = f"letter {number}"
        values = reader.mapping(entry, what, ("rgb", "shape"))
        channels = reader.sequence(values["rgb"], f"rgb of {what}", 3)
        rgb = tuple(reader.integer(channel, f"rgb of {what}", 0, 255) for channel in channels)
        try:
            letter = Letter((rgb[0], rgb[1], rgb[2]), reader.text(values["shape"], f"shape of {what}"))
        except PatternError as error:
            raise reader.fail(entry, f"{what}: {error}") from None
        if letter in letters:
            raise reader.fail(entry, f"{what} looks like letter {letters.index(letter)}: both are {letter}")
        letters.append(letter)
    return tuple(letters)


def _read_rows(reader: _Reader, node: yaml.Node, alphabet: int, window: int) -> NDArray[np.uint8]:
    entries = reader.sequence(node, "rows")
    if len(entries) < window:
        raise reader.fail(node, f"{len(entries)} rows hold no {window}x{window} window")
    rows: list[NDArray[np.uint8]] = []
    for number, entry in enumerate(entries):
        text = reader.text(entry, f"row {number}")
        values = _VALUE_OF_BYTE[np.frombuffer(text.encode("utf-8"), dtype=np.uint8)]
        if rows and len(values) != len(rows[0]):
            raise reader.fail(entry, f"row {number} has {len(values)} symbols, row 0 has {len(rows[0])}")
        if len(values) < window:
            raise reader.fail(entry, f"row {number} has {len(values)} symbols, a window needs {window}")
        wrong = np.flatnonzero(values >= alphabet)
        if len(wrong):
            column = int(wrong[0])
            raise reader.fail(
                entry,
                f"row {number}, column {column}: symbol {text[column]!r} is not one of the {alphabet} letters "
                f"(0 to {DIGITS[alphabet - 1]})",
            )
        rows.append(values)
    return np.array(rows, dtype=np.uint8)


def load_pattern(path: str | Path) -> Pattern:
    """Read a pattern file. Raises PatternFileError with the line and the reason."""
    path = Path(path)
    reader = _Reader(path)
    root = _compose(path)
    values = reader.mapping(root, "the pattern", KEYS)
    grid = reader.text(values["grid"], "grid")
    if grid not in {kind.value for kind in Grid}:
        raise reader.fail(values["grid"], f"grid is {grid!r}, it must be square or hexagonal")
    window = reader.integer(values["window"], "window", 3, 99)
    if window % 2 == 0:
        raise reader.fail(values["window"], f"window is {window}, it must be odd so that a spot lies in its middle")
    min_hamming = reader.integer(values["min_hamming"], "min_hamming", 1, window * window)
    projector = reader.mapping(values["projector"], "projector", ("width", "height"))
    letters = _read_letters(reader, values["letters"])
    symbols = _read_rows(reader, values["rows"], len(letters), window)
    u0, v0 = (reader.number(node, "origin") for node in reader.sequence(values["origin"], "origin", 2))
    fields: dict[str, Any] = {
        "projector_width": reader.integer(projector["width"], "projector width", 1, 2**16),
        "projector_height": reader.integer(projector["height"], "projector height", 1, 2**16),
        "pitch": reader.number(values["pitch"], "pitch", above=0.0),
        "spot_diameter": reader.number(values["spot_diameter"], "spot_diameter", above=0.0),
    }
    try:
        return Pattern(Grid(grid), symbols, letters, window, min_hamming, origin=(u0, v0), **fields)
    except PatternError as error:
        raise reader.fail(values["pitch"], str(error)) from None


def format_pattern(pattern: Pattern) -> str:
    """The text of the pattern file."""
    lines = [
        f"grid: {pattern.grid.value}",
        f"window: {pattern.window}",
        f"min_hamming: {pattern.min_hamming}",
        f"projector: {{width: {pattern.projector_width}, height: {pattern.projector_height}}}",
        f"pitch: {float(pattern.pitch)!r}",
        f"origin: [{pattern.origin[0]!r}, {pattern.origin[1]!r}]",
        f"spot_diameter: {float(pattern.spot_diameter)!r}",
        "letters:",
    ]
    for letter in pattern.letters:
        red, green, blue = letter.rgb
        lines += [f"- rgb: [{red}, {green}, {blue}]", f"  shape: {letter.shape}"]
    lines.append("rows:")
    lines += [f'- "{_BYTE_OF_VALUE[row].tobytes().decode()}"' for row in pattern.symbols]
    return "\n".join(lines) + "\n"


def save_pattern(pattern: Pattern, path: str | Path) -> None:
    """Write the pattern file, whole or not at all."""
    write_text(path, format_pattern(pattern))
