"""Confidences under seeded corruptions are the shares that are right; the tables' script says what it cannot read."""

import numpy as np
import pytest
from decoder_helpers import default_pattern

from sl_decoder.reliability import EDGES, Outcome, corrupted, main, pooled, reliability

PATTERN = default_pattern()


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    cases = (
        {"flipped": 0.01},
        {"flipped": 0.05},
        {"flipped": 0.1},
        {"missing": 0.1},
        {"flipped": 0.05, "missing": 0.2},
    )
    return pooled([corrupted(PATTERN, runs=6, **case) for case in cases])


def test_of_the_dots_given_p_no_fewer_than_p_are_right(outcome: Outcome) -> None:
    for low, high, number, mean, right in reliability(outcome):
        noise = np.sqrt(mean * (1 - mean) / number)
        assert right >= mean - 3 * noise - 1 / number, (low, high, number, mean, right)


def test_low_confidences_are_given_to_the_dots_that_are_wrong(outcome: Outcome) -> None:
    assert outcome.shares()[1] < 0.001
    wrong = ~outcome.right
    assert wrong.sum() == 0 or outcome.confidence[wrong].mean() < np.quantile(outcome.confidence, 0.1)


def test_bins_hold_every_dot_once() -> None:
    confidence = np.concatenate([np.array(EDGES), np.random.default_rng(0).random(500)])
    bins = reliability(Outcome(confidence, confidence > 0.5, 600))
    assert sum(number for _, _, number, _, _ in bins) == len(confidence)
    assert bins[-1][2] == (confidence >= EDGES[-2]).sum()


def test_a_folder_without_images_is_named(tmp_path, capsys) -> None:
    assert main(["--rendered", str(tmp_path)]) == 1
    assert str(tmp_path) in capsys.readouterr().err
