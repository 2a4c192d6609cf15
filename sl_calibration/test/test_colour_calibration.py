"""Colour calibration: the response of a simulated cell with gamma and crosstalk, letters farther apart, refusals."""

import cv2
import numpy as np
import pytest
import yaml

from pattern_gen import default_pattern
from pattern_gen.charts import colour_chart, intensity_chart, intensity_levels
from sl_calibration.colour_calibration import calibrate_colours
from sl_calibration.colour_charts import colour_chart_samples
from sl_calibration.colour_letters import LetterOptions, choose_letters, least_distance
from sl_calibration.colour_response import fit_response
from sl_calibration.commands.colours import main
from sl_common.errors import InvalidInputError

WIDTH, HEIGHT = 84, 64
LEAK = np.array([[1.0, 0.12, 0.02], [0.08, 1.0, 0.14], [0.02, 0.14, 1.0]])
FILTERS = np.array([[0.74, 0.20, 0.06], [0.16, 0.68, 0.16], [0.05, 0.24, 0.71]])
PATTERN = default_pattern()


def scene(coloured=False):
    rng = np.random.default_rng(2)
    albedo = np.clip(0.8 + 0.08 * rng.normal(size=(HEIGHT, WIDTH, 1)), 0.3, 1.0) * np.ones(3)
    if coloured:
        albedo[:, : WIDTH // 2] *= (0.95, 0.35, 0.3)
    return albedo


def photograph(frame, albedo, *, exposure=0.55, noise=1.0, seed=0):
    """(H, W, 3) uint8 BGR: what a camera with gamma, white balance and overlapping filters sees of an RGB frame."""
    light = np.stack([(frame[..., k] / 255.0) ** g for k, g in enumerate((2.4, 2.2, 2.6))], axis=-1) @ LEAK.T
    sensor = 0.02 + exposure * albedo * (light @ FILTERS.T) * (0.55, 1.0, 1.25)
    image = 255 * np.clip(sensor, 0, 1) ** (1 / 1.8)
    image = image + np.random.default_rng(seed).normal(0, noise, image.shape)
    return np.clip(np.round(image), 0, 255).astype(np.uint8)[..., ::-1]


def chart_photographs(albedo, **options):
    return np.stack([photograph(colour_chart(WIDTH, HEIGHT, s), albedo, seed=s, **options) for s in range(28)])


def intensity_photographs(albedo):
    frames = [intensity_chart(WIDTH, HEIGHT, c, s) for c in range(3) for s in range(len(intensity_levels()))]
    return np.stack([photograph(frame, albedo, seed=k) for k, frame in enumerate(frames)])


def seen(drives, albedo=0.8):
    """Noise-free camera values above black (A, 3), R G B."""
    frame = np.asarray(drives, dtype=np.float64)[None]
    black = photograph(np.zeros((1, 1, 3)), albedo * np.ones(3), noise=0)[..., ::-1].astype(float)
    return (photograph(frame, albedo * np.ones(3), noise=0)[..., ::-1].astype(float) - black)[0]


@pytest.mark.parametrize("with_intensity", [False, True])
def test_letters_move_apart_by_half_and_more(with_intensity):
    intensity = intensity_photographs(scene()) if with_intensity else None
    samples = colour_chart_samples(chart_photographs(scene()), intensity)
    result = calibrate_colours(samples, PATTERN)
    shapes = result.shapes
    before = least_distance(seen([letter.rgb for letter in PATTERN.letters]), shapes)
    after = least_distance(seen(result.drives), shapes)
    assert after > 1.5 * before
    assert result.least_after == pytest.approx(after, rel=0.12)
    assert np.abs(result.camera - seen(result.drives)).max() < 10
    assert result.model.rms < 3


def test_the_response_predicts_drives_it_has_not_seen():
    samples = colour_chart_samples(chart_photographs(scene()), intensity_photographs(scene()))
    model = fit_response(samples.drives, samples.camera)
    drives = np.random.default_rng(1).integers(0, 256, (40, 3))
    error = model.camera(drives) - seen(drives)
    assert np.sqrt((error**2).mean()) < 4
    assert (np.diff(model.responses, axis=1) >= 0).all()
    assert np.allclose(model.responses[:, [0, -1]], (0, 1))


def test_nothing_saturates_and_nothing_is_too_dark():
    samples = colour_chart_samples(chart_photographs(scene(), exposure=0.9))
    options = LetterOptions(ceiling=200.0, floor=0.4)
    result = calibrate_colours(samples, PATTERN, options)
    assert result.camera.max() <= 200.5
    brightness = result.camera.max(axis=1)
    assert brightness.min() >= 0.4 * 0.9 * brightness.max()


def test_letters_of_different_shapes_may_share_a_colour():
    samples = colour_chart_samples(chart_photographs(scene()))
    model = fit_response(samples.drives, samples.camera)
    one = choose_letters(model, ("disc",) * 6)
    two = choose_letters(model, ("disc",) * 3 + ("ring",) * 3)
    assert least_distance(model.camera(two), ("disc",) * 3 + ("ring",) * 3) > 1.2 * least_distance(
        model.camera(one), ("disc",) * 6
    )


def test_adaptation_to_a_coloured_scene():
    samples = colour_chart_samples(chart_photographs(scene(coloured=True)))
    assert len(samples.albedos) >= 2
    plain = calibrate_colours(samples, PATTERN)
    adapted = calibrate_colours(samples, PATTERN, adapt_to_scene=True)
    scale = samples.albedos / samples.albedos.max(axis=1, keepdims=True)

    def worst(result):
        return min(least_distance(result.camera * surface, result.shapes, 0.5) for surface in scale)

    assert worst(adapted) >= worst(plain) - 1e-6


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        (lambda f: f[:20], "has 28 frames, got 20"),
        (lambda f: f[np.random.default_rng(0).permutation(28)], "wrong order"),
        (lambda f: np.full_like(f, 30), "light in the image"),
        (lambda f: np.clip(f.astype(int) * 4, 0, 255).astype(np.uint8), "saturates"),
    ],
)
def test_bad_charts_are_refused(frames, message):
    with pytest.raises(InvalidInputError, match=message):
        colour_chart_samples(frames(chart_photographs(scene())))


def test_command_writes_what_publisher_and_decoder_read(tmp_path, capsys):
    from pattern_gen.colours_file import with_calibrated_colours
    from sl_decoder.colours import load_colours

    chart = tmp_path / "chart"
    chart.mkdir()
    for k, image in enumerate(chart_photographs(scene())):
        cv2.imwrite(str(chart / f"step_{k}.png"), image)
    PATTERN.save(tmp_path / "pattern.yaml")
    output = tmp_path / "colours.yaml"
    arguments = ["--pattern", str(tmp_path / "pattern.yaml"), "--chart", str(chart), "--output", str(output)]
    assert main(arguments) == 0
    assert "least distance of two letters" in capsys.readouterr().out
    data = yaml.safe_load(output.read_text())
    assert {"date", "units", "residuals", "samples", "responses", "mixing", "letters"} <= set(data)
    assert data["least_distance"]["after"] > 1.5 * data["least_distance"]["before"]
    letters = with_calibrated_colours(PATTERN, output).letters
    assert [list(letter.rgb) for letter in letters] == [entry["rgb"] for entry in data["letters"]]
    assert load_colours(output).rgb.shape == (6, 3)

    (chart / "step_5.png").unlink()
    output.unlink()
    assert main(arguments) == 1
    assert "has 28 frames, got 27" in capsys.readouterr().err
    assert not output.exists()
