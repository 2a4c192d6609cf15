"""What every command line of the stack does in the same way: its help, its exit code, its progress bar."""

import argparse
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

from tqdm import tqdm

from sl_common.errors import StructuredLightError

Item = TypeVar("Item")

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""


class UsageError(StructuredLightError):
    """The options contradict each other or lie outside of their range: wrong usage, exit code 2."""


def make_parser(command: str, description: str, example: str) -> argparse.ArgumentParser:
    """Return a parser for ``ros2 run PKG EXE``.

    Args:
        command: "PKG EXE".
        description: What it does, for --help.
        example: One or more whole command lines, or a text that begins with them.
    """
    return argparse.ArgumentParser(
        prog=f"ros2 run {command}",
        description=description,
        epilog=f"example:\n{example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def run_command(
    parser: argparse.ArgumentParser,
    action: Callable[[argparse.Namespace], int | None],
    arguments: Sequence[str] | None = None,
) -> int:
    """Parse the command line, act, and return the exit code.

    0 done, or what ``action`` returns; 1 failed, with one line on stderr; 130 after Ctrl-C. Wrong usage, also what
    ``action`` raises as UsageError, ends in the parser, with 2.
    """
    options = parser.parse_args(arguments)
    try:
        return action(options) or 0
    except UsageError as error:
        parser.error(str(error))
    except StructuredLightError as error:
        return _failed(str(error))
    except OSError as error:
        return _failed(f"{error.filename or 'file'}: {error.strerror or error}")
    except KeyboardInterrupt:
        print("stopped: what was not finished is not written", file=sys.stderr)
        return INTERRUPTED


def progress(items: Iterable[Item], label: str, total: int | None = None) -> Iterable[Item]:
    """Iterate with a progress bar, shown on a terminal once it takes more than two seconds."""
    return tqdm(items, desc=label, total=total, delay=2.0, disable=None, leave=False)


def _failed(message: str) -> int:
    print(f"error: {' '.join(message.split())}", file=sys.stderr)
    return 1
