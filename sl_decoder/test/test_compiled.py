"""Kernels: native where the types fit, numba elsewhere; no compiler in a process that decodes; memory that stays."""

import platform
import subprocess
import sys

import numpy as np
import pytest

from pattern_gen import default_pattern
from sl_decoder import compiled, native
from sl_decoder.benchmark import camera_image, memory_growth


def total(values, scale):
    result = 0.0
    for value in values:
        result += value
    return result * scale


@pytest.fixture
def kernel(monkeypatch):
    """A kernel whose native twin, for float32 vectors and integers, gives itself away."""
    takes = native.read(native.describe((np.zeros(3, np.float32), 2)))
    monkeypatch.setattr(native, "find", lambda name: (lambda values, scale: "native", takes))
    made = compiled.compiled(total)
    yield made
    compiled.kernels.remove(made)


def test_the_native_kernel_runs_only_for_what_it_was_built_for(kernel) -> None:
    assert kernel(np.ones(5, np.float32), 3) == "native"
    assert kernel(np.ones(5, np.float32), np.int64(3)) == "native"
    assert kernel(np.ones(5, np.float64), 3) == 15
    assert kernel(np.ones(10, np.float32)[::2], 3) == 15
    assert kernel(np.ones(5, np.float32), 3.5) == 17.5
    assert kernel(np.ones(5, np.int32), 3) == 15


def test_tuples_are_compared_by_their_members() -> None:
    described = native.describe(((np.zeros((2, 3), np.float32), np.float32(1)), True))
    takes = native.read(described)
    assert compiled.fit(((np.ones((4, 4), np.float32), np.float32(2)), False), takes)
    assert not compiled.fit(((np.ones(4, np.float32), np.float32(2)), False), takes)
    assert not compiled.fit(((np.ones((4, 4), np.float32), 2.0), False), takes)
    assert not compiled.fit((np.ones((4, 4), np.float32), False), takes)
    assert native.describe((np.zeros((4, 4))[:, ::2],)) == ""


def test_a_process_that_decodes_needs_no_compiler() -> None:
    if not native.available():
        pytest.skip("no native library for these sources: make build")
    code = "import sys; from sl_decoder.warmup import warm_up; print(warm_up() > 2000, 'numba' in sys.modules)"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.split() == ["True", "False"]


DECODE = """
import resource, sys
import numpy as np
from pattern_gen import default_pattern
from sl_decoder import Decoder

decoder, image = Decoder(default_pattern()), np.load(sys.argv[1])
for _ in range(8):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    found = len(decoder.decode(image))
    print(found, resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.parametrize("size", [(640, 480), (1280, 960)])
def test_an_image_finds_the_memory_of_the_image_before(size, tmp_path) -> None:
    if not native.available() or platform.libc_ver()[0] != "glibc":
        pytest.skip("no native library for these sources (make build), or another C library")
    np.save(tmp_path / "image.npy", camera_image(default_pattern(), *size))
    command = [sys.executable, "-c", DECODE, str(tmp_path / "image.npy")]
    answer = subprocess.run(command, capture_output=True, text=True, check=True)
    found, pages = np.array(answer.stdout.split(), int).reshape(-1, 2).T
    assert (found > 2000).all()
    assert np.median(pages[1:]) < 50  # 709 and 2429 where the system gets it back after each image


def test_memory_does_not_grow_with_the_images() -> None:
    megabytes, blocks = memory_growth(1500)
    assert megabytes < 2.0
    assert blocks < 375  # half an allocation for each image counted: nothing is kept of any
