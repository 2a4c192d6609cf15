"""From radiance in front of the lens to the 8-bit image of a colour camera."""

from dataclasses import dataclass

import cv2
import numpy as np

from sl_common.cameras import CameraModel
from sl_sim.projector import linear_to_srgb

_BAYER_TO_BGR = {  # OpenCV names a mosaic by its second row, from the second column on
    "rggb": (cv2.COLOR_BayerBG2BGR, cv2.COLOR_BayerBG2BGR_EA),
    "bggr": (cv2.COLOR_BayerRG2BGR, cv2.COLOR_BayerRG2BGR_EA),
    "grbg": (cv2.COLOR_BayerGB2BGR, cv2.COLOR_BayerGB2BGR_EA),
    "gbrg": (cv2.COLOR_BayerGR2BGR, cv2.COLOR_BayerGR2BGR_EA),
}


@dataclass(frozen=True, kw_only=True)
class SensorOptions:
    """An industrial colour camera.

    Attributes:
        exposure: gain from radiance to the share of the full well; 0 = automatic, so that the brightest
            `auto_share` of the pixels reaches `auto_level`.
        auto_share, auto_level: see exposure.
        exposure_bias: stops added to the automatic exposure; +1 = twice as long.
        full_well: electrons of a saturated pixel. read_noise: electrons, standard deviation.
        adc_bits: 0 = no quantisation before the response curve.
        crosstalk: (3, 3) response of sensor channel i (R, G, B) to light of channel j.
        white_balance: gains of R, G, B after the sensor; None = such that white projector light comes out white.
        bayer: "rggb", "bggr", "grbg", "gbrg" or "" for three full channels; demosaic: "edge" or "bilinear".
        gamma: response curve of the output: "srgb", or an exponent (1 = linear, 2.2 = value ** (1 / 2.2)).
        blur: standard deviation of the lens and pixel blur [px].
        vignetting: share of the cos^4 law that the lens shows, 0..1.
        jpeg: quality of the transport's compression, 0 = none.
        noise: False switches shot and read noise off.
    """

    exposure: float = 0.0
    auto_share: float = 0.005
    auto_level: float = 0.85
    exposure_bias: float = 0.0
    full_well: float = 10000.0
    read_noise: float = 8.0
    adc_bits: int = 10
    crosstalk: tuple[tuple[float, float, float], ...] = ((0.88, 0.10, 0.02), (0.08, 0.84, 0.08), (0.02, 0.13, 0.85))
    white_balance: tuple[float, float, float] | None = None
    bayer: str = "rggb"
    demosaic: str = "edge"
    gamma: str | float = "srgb"
    blur: float = 0.45
    vignetting: float = 0.6
    jpeg: int = 0
    noise: bool = True


def lens_falloff(camera: CameraModel, strength: float) -> np.ndarray:
    """(H, W, 1) float32 share of light that reaches each pixel: (cos^4 of the viewing angle) ** strength."""
    u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    rays = camera.rays(np.stack([u, v], -1).reshape(-1, 2))
    cosine2 = 1.0 / (rays**2).sum(1)
    return (cosine2 ** (2.0 * strength)).astype(np.float32).reshape(camera.height, camera.width, 1)


def filtered(radiance: np.ndarray, falloff: np.ndarray, options: SensorOptions) -> np.ndarray:
    """Sensor signal (H, W, 3) float32 RGB before exposure, of radiance (H, W, 3) float32: falloff, blur, colour
    filters.
    """
    signal = cv2.transform(radiance, np.asarray(options.crosstalk, np.float32))
    signal *= falloff
    if options.blur > 0:
        signal = cv2.GaussianBlur(signal, (0, 0), options.blur, borderType=cv2.BORDER_REPLICATE)
    return signal


def automatic_exposure(signal: np.ndarray, options: SensorOptions) -> float:
    """Gain that brings the brightest auto_share of the pixels' largest channel to auto_level of the full well."""
    peak = np.ascontiguousarray(signal[::2, ::2].max(-1)).ravel()  # every other pixel, as metering does
    count = max(1, round(options.auto_share * peak.size))
    level = float(np.partition(peak, peak.size - count)[peak.size - count])
    return options.auto_level / max(level, 1e-6) * 2.0**options.exposure_bias


def white_gains(options: SensorOptions) -> np.ndarray:
    """(3,) gains R, G, B."""
    if options.white_balance is not None:
        return np.asarray(options.white_balance, float)
    response = np.asarray(options.crosstalk, float).sum(1)
    return response.max() / response


def expose(signal: np.ndarray, exposure: float, options: SensorOptions, rng: np.random.Generator) -> np.ndarray:
    """Developed image (H, W, 3) uint8 BGR of a sensor signal (H, W, 3) float32 RGB at this exposure gain."""
    if options.bayer:
        raw = _mosaic(signal, options.bayer)
    else:
        raw = signal
    electrons = raw * np.float32(exposure * options.full_well)
    if options.noise:
        variance = np.maximum(electrons, 0.0) + np.float32(options.read_noise**2)
        np.sqrt(variance, out=variance)
        variance *= rng.standard_normal(electrons.shape, dtype=np.float32)
        electrons += variance
    top = (1 << options.adc_bits) - 1 if options.adc_bits else 65535
    codes = np.clip(electrons * np.float32(top / options.full_well) + np.float32(0.5), 0, top).astype(np.uint16)
    gains = white_gains(options)
    # White balance belongs before demosaicing, where edges are compared between channels.
    if options.bayer:
        tables = np.clip(np.outer(gains, np.arange(top + 1)) * (65535.0 / top) / gains.max(), 0, 65535).astype(
            np.uint16
        )
        for channel, (row, col) in _sites(options.bayer):
            codes[row::2, col::2] = tables[channel][codes[row::2, col::2]]
        bgr = cv2.cvtColor(codes, _BAYER_TO_BGR[options.bayer][1 if options.demosaic == "edge" else 0])
        bgr = _response_table(options, gains.max())[bgr]
    else:
        tables = np.clip(np.outer(gains, np.arange(top + 1)) * (65535.0 / top) / gains.max(), 0, 65535).astype(
            np.uint16
        )
        response = _response_table(options, gains.max())
        bgr = np.stack([response[tables[k][codes[..., k]]] for k in (2, 1, 0)], -1)
    if options.jpeg:
        bgr = cv2.imdecode(cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, options.jpeg])[1], cv2.IMREAD_COLOR)
    return np.ascontiguousarray(bgr)


def _response_table(options: SensorOptions, gain: float) -> np.ndarray:
    """(65536,) uint8 output of balanced 16-bit values that were divided by the largest white gain."""
    value = np.clip(np.arange(65536) / 65535.0 * gain, 0.0, 1.0)
    curve = linear_to_srgb(value) if isinstance(options.gamma, str) else value ** (1.0 / options.gamma)
    return np.round(255.0 * curve).astype(np.uint8)


def _sites(bayer: str) -> list[tuple[int, tuple[int, int]]]:
    return [("rgb".index(letter), (k // 2, k % 2)) for k, letter in enumerate(bayer)]


def _mosaic(signal: np.ndarray, bayer: str) -> np.ndarray:
    raw = np.empty(signal.shape[:2], np.float32)
    for channel, (row, col) in _sites(bayer):
        raw[row::2, col::2] = signal[row::2, col::2, channel]
    return raw
