"""Exit codes and messages of command lines."""

import pytest

from sl_common.commands import UsageError, make_parser, progress, run_command
from sl_common.errors import StructuredLightError


def parser():
    result = make_parser("pkg exe", "Does it.", "  ros2 run pkg exe --number 3")
    result.add_argument("--number", type=int, default=1)
    return result


def raising(error):
    def action(_options):
        raise error

    return action


def test_done_is_0_and_the_action_sees_its_options():
    seen = []
    assert run_command(parser(), lambda options: seen.append(options.number), ["--number", "3"]) == 0
    assert seen == [3]


def test_the_actions_own_code_is_returned():
    assert run_command(parser(), lambda _: 1, []) == 1


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (StructuredLightError("7 is too\n  many"), "error: 7 is too many\n"),
        (FileNotFoundError(2, "No such file or directory", "a.yaml"), "error: a.yaml: No such file or directory\n"),
        (OSError("no space"), "error: file: no space\n"),
    ],
)
def test_a_failure_is_one_line_and_1(error, said, capsys):
    assert run_command(parser(), raising(error), []) == 1
    assert capsys.readouterr().err == said


def test_an_interruption_is_one_line_and_130(capsys):
    assert run_command(parser(), raising(KeyboardInterrupt()), []) == 130
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_programming_error_is_not_hidden():
    with pytest.raises(ZeroDivisionError):
        run_command(parser(), raising(ZeroDivisionError()), [])


def test_wrong_usage_is_2_and_help_shows_the_example(capsys):
    with pytest.raises(SystemExit) as ended:
        run_command(parser(), lambda _: 0, ["--colour"])
    assert ended.value.code == 2
    with pytest.raises(SystemExit) as ended:
        run_command(parser(), raising(UsageError("--number 7 is above 5")), [])
    assert ended.value.code == 2
    assert "--number 7 is above 5" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        run_command(parser(), lambda _: 0, ["--help"])
    shown = capsys.readouterr().out
    assert "usage: ros2 run pkg exe" in shown
    assert "example:\n  ros2 run pkg exe --number 3" in shown


def test_progress_changes_nothing():
    assert list(progress(range(5), "items")) == [0, 1, 2, 3, 4]
