import sys

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import Header

from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError
from sl_common.ros import camera_info, clouds, images, stamps

RNG = np.random.default_rng(3)
BGR = RNG.integers(0, 256, (6, 10, 3), dtype=np.uint8)


def message(pixels, encoding, padding=0, bigendian=False):
    rows = np.ascontiguousarray(pixels).reshape(pixels.shape[0], -1)
    rows = rows.view(np.uint8) if rows.dtype == np.uint8 else rows.astype(">u2" if bigendian else "<u2").view(np.uint8)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=99)
    return Image(
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        step=rows.shape[1],
        is_bigendian=int(bigendian),
        data=rows.tobytes(),
    )


@given(st.sampled_from(["bgr8", "rgb8", "bgra8", "rgba8"]), st.integers(0, 5))
def test_colour_encodings_and_padded_rows(encoding, padding):
    pixels = BGR if "bgr" in encoding else BGR[..., ::-1]
    if "a" in encoding:
        pixels = np.dstack([pixels, np.full(pixels.shape[:2], 7, np.uint8)])
    assert np.array_equal(images.to_bgr(message(pixels, encoding, padding)), BGR)


@pytest.mark.parametrize("bigendian", [False, True])
@pytest.mark.parametrize("encoding", ["mono16", "rgb16"])
def test_sixteen_bits_keep_the_upper_byte_of_either_byte_order(encoding, bigendian):
    shape = (6, 10) if encoding == "mono16" else (6, 10, 3)
    pixels = RNG.integers(0, 65536, shape, dtype=np.uint16)
    bgr = images.to_bgr(message(pixels, encoding, bigendian=bigendian))
    expected = (pixels >> 8).astype(np.uint8)
    assert np.array_equal(bgr, expected[..., ::-1] if expected.ndim == 3 else np.dstack([expected] * 3))


@pytest.mark.parametrize("order", ["rggb", "bggr", "gbrg", "grbg"])
def test_a_uniform_colour_survives_every_bayer_order(order):
    colour = {"r": 200, "g": 120, "b": 40}
    mosaic = np.empty((8, 8), np.uint8)
    for i, channel in enumerate(order):
        mosaic[i // 2 :: 2, i % 2 :: 2] = colour[channel]
    bgr = images.to_bgr(message(mosaic, f"bayer_{order}8"))
    assert (bgr[2:-2, 2:-2] == [40, 120, 200]).all()


def test_image_round_trip():
    sent = images.to_message(BGR, Header(frame_id="camera"))
    assert (sent.height, sent.width, sent.step, sent.header.frame_id) == (6, 10, 30, "camera")
    assert np.array_equal(images.to_bgr(sent), BGR)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"encoding": "yuv422"}, "'yuv422' is not supported"),
        ({"step": 29}, "step is 29 bytes, but 10 pixels of bgr8 take 30"),
        ({"height": 7}, "has 180 bytes, but 10x7 bgr8 with step 30 takes 210"),
        ({"width": 0}, "empty: 0x6"),
    ],
)
def test_images_that_do_not_fit_are_refused_with_the_numbers(changes, reason):
    bad = message(BGR, "bgr8")
    for name, value in changes.items():
        setattr(bad, name, value)
    with pytest.raises(InvalidInputError, match=reason):
        images.to_bgr(bad)


def test_cloud_round_trip_with_mixed_types():
    n = 50
    fields = {
        "x": RNG.normal(size=n).astype(np.float32),
        "y": RNG.normal(size=n).astype(np.float32),
        "z": RNG.normal(size=n).astype(np.float32),
        "rgb": clouds.pack_rgb(RNG.integers(0, 256, (n, 3), dtype=np.uint8)),
        "row": RNG.integers(0, 44, n).astype(np.uint16),
    }
    sent = clouds.to_message(Header(), **fields)
    assert (sent.point_step, sent.row_step, sent.height, sent.width) == (18, 18 * n, 1, n)
    received = clouds.from_message(sent)
    assert list(received) == list(fields)
    for name, values in fields.items():
        assert received[name].tobytes() == values.tobytes()


def test_rgb_packs_as_pcl_expects():
    packed = clouds.pack_rgb([[1, 2, 3]])
    assert packed.view(np.uint32)[0] == 0x010203
    assert clouds.unpack_rgb(packed).tolist() == [[1, 2, 3]]


def test_organised_clouds_with_padding_and_the_other_byte_order_are_read():
    order = "<" if sys.byteorder == "big" else ">"
    points = np.zeros((2, 3), dtype=np.dtype([(k, f"{order}f4") for k in "xyz"] + [("pad", "u1", 4)]))
    points["x"] = np.arange(6).reshape(2, 3)
    row = points.tobytes()
    sent = clouds.to_message(Header(), x=np.zeros(1, np.float32), y=np.zeros(1, np.float32), z=np.zeros(1, np.float32))
    sent.is_bigendian = not sent.is_bigendian
    sent.height, sent.width, sent.point_step, sent.row_step = 2, 3, 16, 50
    sent.data = row[:48] + b"\0\0" + row[48:] + b"\0\0"
    assert clouds.from_message(sent)["x"].tolist() == [0, 1, 2, 3, 4, 5]


def test_clouds_that_do_not_fit_are_refused():
    with pytest.raises(InvalidInputError, match="lacks x, y or z"):
        clouds.from_message(PointCloud2())
    with pytest.raises(InvalidInputError, match="equal length"):
        clouds.to_message(Header(), x=[1.0], y=[1.0, 2.0], z=[1.0])
    short = clouds.to_message(Header(), **{k: np.zeros(4, np.float32) for k in "xyz"})
    short.data = short.data[:-1]
    with pytest.raises(InvalidInputError, match="takes 48 bytes, got 47"):
        clouds.from_message(short)


def test_empty_cloud_round_trip():
    empty = clouds.to_message(Header(), **{k: np.zeros(0, np.float32) for k in "xyz"})
    assert len(clouds.from_message(empty)["x"]) == 0


def test_camera_info_round_trip_and_its_refusals():
    matrix = np.array([[800.0, 0, 320], [0, 800, 240], [0, 0, 1]])
    model = CameraModel(640, 480, matrix, "plumb_bob", (-0.2, 0.05, 0.001, 0.0, 0.0))
    read = camera_info.from_message(camera_info.to_message(model, Header()))
    assert read.coefficients == model.coefficients
    assert np.array_equal(read.matrix, model.matrix)
    with pytest.raises(InvalidInputError, match="not calibrated"):
        camera_info.from_message(CameraInfo())
    fisheye = camera_info.to_message(model, Header())
    fisheye.distortion_model = "equidistant"
    with pytest.raises(InvalidInputError, match="equidistant"):
        camera_info.from_message(fisheye)


@given(st.integers(0, 2**62))
def test_stamp_round_trip(nanoseconds):
    assert stamps.to_ns(stamps.from_ns(nanoseconds)) == nanoseconds


def test_a_bgr_image_is_not_copied():
    sent = images.to_message(cv2.resize(BGR, (640, 480)), Header())
    assert not images.to_bgr(sent).flags.owndata
