import numpy as np
import pytest

from sl_common.cameras import CameraModel
from sl_sim import sensor
from sl_sim.projector import LIGHT_SCALE, ProjectorOptions, channel_light, light_image, linear_to_srgb, srgb_to_linear
from sl_sim.sensor import SensorOptions

IDENTITY = tuple(np.eye(3))
PLAIN = {"crosstalk": IDENTITY, "gamma": 1.0, "blur": 0.0, "bayer": ""}


def grey(level, shape=(200, 300)):
    return np.full((*shape, 3), level, np.float32)


def test_noise_follows_photon_transfer():
    """Variance in electrons is mean + read noise squared."""
    options = SensorOptions(**PLAIN, full_well=5000.0, read_noise=10.0, adc_bits=0)
    for level in (0.2, 0.5, 0.8):
        image = sensor.expose(grey(level), 1.0, options, np.random.default_rng(0)).astype(float)
        electrons = image / 255 * 5000
        assert electrons.mean() == pytest.approx(5000 * level, rel=0.003)
        rounding = (5000 / 255) ** 2 / 12
        assert electrons.var() == pytest.approx(5000 * level + 100 + rounding, rel=0.05)


def test_without_noise_levels_are_exact_and_saturate():
    options = SensorOptions(**PLAIN, noise=False, adc_bits=0)
    for level, code in ((0.0, 0), (0.5, 128), (1.0, 255), (3.0, 255)):
        assert np.abs(sensor.expose(grey(level), 1.0, options, np.random.default_rng(0)).astype(int) - code).max() <= 1


@pytest.mark.parametrize("bayer", ["rggb", "bggr", "grbg", "gbrg"])
@pytest.mark.parametrize("demosaic", ["edge", "bilinear"])
def test_each_mosaic_gives_back_flat_colours(bayer, demosaic):
    options = SensorOptions(
        crosstalk=IDENTITY, gamma=1.0, blur=0.0, bayer=bayer, demosaic=demosaic, noise=False, white_balance=(1.0,) * 3
    )
    signal = grey(1.0) * np.array([0.8, 0.5, 0.2], np.float32)
    image = sensor.expose(signal, 1.0, options, np.random.default_rng(0))[2:-2, 2:-2]
    np.testing.assert_allclose(image.reshape(-1, 3).mean(0), [51, 127.5, 204], atol=1.5)


def test_white_light_comes_out_white_through_the_colour_filters():
    options = SensorOptions(noise=False, blur=0.0)
    signal = sensor.filtered(grey(0.4), np.ones((200, 300, 1), np.float32), options)
    image = sensor.expose(signal, 1.0, options, np.random.default_rng(0))[4:-4, 4:-4].reshape(-1, 3).astype(float)
    assert np.ptp(image.mean(0)) < 2


def test_automatic_exposure_brings_the_brightest_share_to_its_level():
    options = SensorOptions(auto_share=0.01, auto_level=0.8)
    signal = np.random.default_rng(0).uniform(0, 7, (100, 100, 3)).astype(np.float32)
    gain = sensor.automatic_exposure(signal, options)
    assert (signal.max(-1) * gain >= 0.8 - 1e-6).mean() == pytest.approx(0.01, abs=1e-3)
    brighter = SensorOptions(auto_share=0.01, auto_level=0.8, exposure_bias=1.0)
    assert sensor.automatic_exposure(signal, brighter) == pytest.approx(2 * gain)


def test_falloff_is_one_in_the_middle_and_cosine_to_the_fourth_outside():
    camera = CameraModel(201, 101, np.array([[100.0, 0, 100], [0, 100.0, 50], [0, 0, 1.0]]))
    falloff = sensor.lens_falloff(camera, 1.0)[..., 0]
    assert falloff[50, 100] == 1.0
    assert falloff[50, 200] == pytest.approx(0.25, rel=1e-5)
    np.testing.assert_allclose(sensor.lens_falloff(camera, 0.0), 1.0)


def test_the_same_generator_gives_the_same_image():
    signal = grey(0.3)
    one, two, other = (sensor.expose(signal, 1.0, SensorOptions(), np.random.default_rng(s)) for s in (1, 1, 2))
    np.testing.assert_array_equal(one, two)
    assert (one != other).any()


def test_jpeg_changes_little_and_keeps_the_size():
    signal = np.random.default_rng(0).uniform(0.2, 0.5, (64, 64, 3)).astype(np.float32)
    plain, packed = (
        sensor.expose(signal, 1.0, SensorOptions(jpeg=q, noise=False), np.random.default_rng(0)) for q in (0, 90)
    )
    assert packed.shape == plain.shape
    assert 0 < np.abs(packed.astype(int) - plain).mean() < 12


def test_srgb_curves_are_inverse():
    x = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(linear_to_srgb(srgb_to_linear(x)), x, atol=1e-6)


def test_projector_light_rises_with_drive_and_leaks_by_its_crosstalk():
    options = ProjectorOptions()
    ramp = np.zeros((256, 3), np.uint8)
    ramp[:, 1] = np.arange(256)
    light = channel_light(ramp, options)
    assert (np.diff(light[:, 1]) >= 0).all()
    assert light[0].max() == pytest.approx(options.black_level)
    assert 0 < light[255, 0] < 0.1 * light[255, 1]
    np.testing.assert_allclose(channel_light(np.array([[255, 255, 255]], np.uint8), options), 1.0, rtol=1e-6)


def test_projector_blur_keeps_the_light_and_its_centre():
    image = np.zeros((40, 60, 3), np.uint8)
    image[20, 30] = 255
    options = ProjectorOptions(black_level=0.0, blur=0.7)
    light = light_image(image, options).astype(float)
    assert light.sum() == pytest.approx(LIGHT_SCALE**2 * 3, rel=1e-3)
    rows, cols = np.mgrid[: light.shape[0], : light.shape[1]]
    weight = light.sum(-1) / light.sum()
    assert ((weight * cols).sum() + 0.5) / LIGHT_SCALE - 0.5 == pytest.approx(30, abs=1e-3)
    assert ((weight * rows).sum() + 0.5) / LIGHT_SCALE - 0.5 == pytest.approx(20, abs=1e-3)
