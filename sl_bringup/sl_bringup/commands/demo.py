"""``ros2 run sl_bringup demo``: the whole chain on a simulated cell, judged against its truth."""

import argparse
import json
import shutil
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from sl_bringup.bag.writer import BackgroundWriter
from sl_bringup.demo import acts, nodes, self_calibration
from sl_bringup.demo.acts import Motion
from sl_bringup.demo.report import Row, passed, table
from sl_bringup.errors import DemoError
from sl_bringup.ros.session import Session
from sl_bringup.terminal import Terminal
from sl_common.commands import UsageError, make_parser, run_command
from sl_common.files import write_text

_EXAMPLE = """  ros2 run sl_bringup demo --scene sphere --output /tmp/demo

The exit code is 0 when the arm ends within 2 mm and 0.5 deg of the commanded pose and of the true surface, with no
limit violation counted by the cell's driver; 1 when not, or when something failed; 130 after Ctrl-C."""


@dataclass(frozen=True)
class Options:
    """The command line; see ``--help``."""

    scene: str
    seed: int
    standoff: float
    duration: float
    calibration: str
    output: Path
    short: bool
    domain_id: int | None
    no_bag: bool


def _parser() -> argparse.ArgumentParser:
    parser = make_parser(
        "sl_bringup demo",
        "Run the whole chain, each node a process of its own, on a simulated cell: an arm with an eye-in-hand camera "
        "positions itself in front of an object by structured light.",
        _EXAMPLE,
    )
    parser.add_argument(
        "--scene", default="cylinder", help="plane, sphere, wavy, bust, boxes, ... (default: %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=1, help="of scene, mounting and noise (default: %(default)s)")
    parser.add_argument("--standoff", type=float, default=0.4, help="camera to surface [m] (default: %(default)s)")
    parser.add_argument("--duration", type=float, default=6.0, help="of the motion [s] (default: %(default)s)")
    parser.add_argument(
        "--calibration",
        choices=("self", "nominal"),
        help="self: the system calibrates itself first (default); nominal: the cell's values with realistic errors "
        "(default with --short)",
    )
    parser.add_argument(
        "--output", type=Path, default=Path("demo_output"), help="folder, replaced (default: %(default)s)"
    )
    parser.add_argument("--short", action="store_true", help="no pictures, no bag, a quicker motion: for CI")
    parser.add_argument("--no-bag", action="store_true", help="record no bag")
    parser.add_argument("--domain-id", type=int, help="ROS domain (default: one that nobody uses)")
    return parser


def _options(parsed: argparse.Namespace) -> Options:
    if not 0.05 <= parsed.standoff <= 2.0:
        raise UsageError(f"--standoff {parsed.standoff:g} is not within 0.05 to 2 m")
    if not 0 <= parsed.duration <= 60:
        raise UsageError(f"--duration {parsed.duration:g} is not within 0 to 60 s")
    parsed.calibration = parsed.calibration or ("nominal" if parsed.short else "self")
    return Options(**vars(parsed))


def run(options: Options, terminal: Terminal) -> bool:
    """Run the demo; returns whether every limit was kept. Raises StructuredLightError where a step fails."""
    _prepare(options.output)
    logs, calibration = options.output / "logs", options.output / "calibration"
    bag = None if options.no_bag or options.short else BackgroundWriter(options.output / "bag")
    started = time.monotonic()
    try:
        with Session(terminal, logs, domain=options.domain_id, bag=bag) as session:
            terminal.step(f"starting the cell (scene {options.scene}, seed {options.seed}) and the chain")
            executables = [nodes.simulated_cell(options.scene, options.seed), *nodes.chain(calibration.resolve())]
            if options.calibration == "self":
                samples = (options.output / "calibration_session").resolve()
                executables.append(nodes.calibrator(calibration.resolve(), samples))
            session.start(executables)
            acts.wait_until_running(session, terminal)
            calibrated = None
            if options.calibration == "self":
                calibrated = self_calibration.self_calibrate(session, terminal)
            else:
                acts.use_nominal_calibration(session, terminal, calibration, options.seed)
            acts.look(session, terminal)
            failure, motion = _move(session, terminal, options)
            codes = session.processes.stop()
            failed = ", ".join(f"{name} with exit code {code}" for name, code in codes.items() if code)
            terminal.step(f"all nodes stopped{', not cleanly: ' + failed if failed else ''}")
            rows = _report(session, options, motion, codes, terminal)
            assert session.observer.truth is not None
            rows = self_calibration.rows(calibration, session.observer.truth, calibrated) + rows
            rows.append(Row("wall time of the run", time.monotonic() - started, "s", digits=0))
    finally:
        if bag is not None:
            bag.close()
    write_text(options.output / "report.txt", table(rows) + "\n")
    write_text(options.output / "report.json", json.dumps([row.as_dict() for row in rows], indent=1) + "\n")
    terminal.plain("\n" + table(rows) + "\n")
    if failure is not None:
        raise failure
    return passed(rows)


def _move(session: Session, terminal: Terminal, options: Options) -> tuple[DemoError | None, Motion | None]:
    """Position the arm; a refusal or an abort is kept for the end, so that the report is made all the same."""
    try:
        duration = min(options.duration, 4.0) if options.short else options.duration
        motion = acts.position(session, terminal, standoff=options.standoff, duration=duration)
        acts.look_closely(session, terminal)
        return None, motion
    except DemoError as error:
        terminal.step(f"not positioned: {error}")
        return error, None


def _report(
    session: Session, options: Options, motion: Motion | None, codes: dict[str, int], terminal: Terminal
) -> list[Row]:
    """Judge the run and draw the pictures."""
    from sl_bringup.demo import figures, gallery  # the scene and matplotlib load while nothing waits for them

    terminal.step("comparing with the truth")
    observer = session.observer
    truth, pattern = observer.truth, observer.latest["pattern"]
    assert truth is not None
    cell = figures.true_cell(truth)
    rows = figures.rows(observer.record, truth, cell, pattern, motion, options.standoff)
    rows.append(Row("nodes that did not stop cleanly", sum(code != 0 for code in codes.values()), "", 0.0, digits=0))
    if not options.short:
        terminal.step("drawing the pictures")
        gallery.draw(options.output, observer, cell, motion)
    return rows


def _prepare(folder: Path) -> None:
    """Make an empty output folder; one that no demo made is left alone."""
    marker = folder / ".structured_light_demo"
    if folder.exists() and any(folder.iterdir()):
        if not marker.exists():
            raise DemoError(f"{folder} is not empty and not a demo's output: choose another --output")
        shutil.rmtree(folder)
    folder.mkdir(parents=True, exist_ok=True)
    marker.touch()


def _act(parsed: argparse.Namespace) -> int:
    options, terminal = _options(parsed), Terminal()
    good = run(options, terminal)
    verdict = "passed" if good else "FAILED: see the rows marked so"
    terminal.plain(f"{verdict}; everything is in {options.output}")
    return 0 if good else 1


def main(arguments: list[str] | None = None) -> int:
    """Run the command; SIGTERM ends it as Ctrl-C does, with all processes."""

    def terminate(_signal: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, terminate)
    return run_command(_parser(), _act, arguments)


if __name__ == "__main__":
    sys.exit(main())
