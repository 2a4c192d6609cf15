import threading
import time

import numpy as np

from arm_positioner.setpoint_loop import SetpointLoop


def run(tick, seconds, period=0.01):
    loop = SetpointLoop(period, tick)
    loop.start()
    time.sleep(seconds)
    loop.stop()
    return loop


def test_it_ticks_once_a_period():
    times = []
    loop = run(lambda: times.append(time.monotonic()), 0.6)
    assert 10 < len(times) <= 61
    assert 0.0095 < np.median(np.diff(times)) < 0.013
    assert not loop.is_alive
    assert loop.jitter()["interval mean [ms]"] >= 9.9


def test_a_late_tick_is_neither_made_up_for_nor_followed_by_a_short_period():
    times = []

    def tick():
        times.append(time.monotonic())
        if len(times) == 10:
            time.sleep(0.055)

    run(tick, 0.5)
    intervals = np.diff(times)
    assert intervals[9] >= 0.055
    assert intervals[10:].min() > 0.6 * 0.01  # no burst after it


def test_a_failure_ends_the_loop_and_is_kept():
    done = threading.Event()

    def tick():
        done.set()
        raise RuntimeError("broken")

    loop = run(tick, 0.1)
    assert done.is_set()
    assert str(loop.failure) == "broken"
