"""Child processes end with their owner, in whatever way."""

import os
import signal
import subprocess
import sys
import time

import pytest

from sl_bringup.errors import ProcessError
from sl_bringup.isolation import DOMAINS, environment, free_domain
from sl_bringup.processes import Executable, ProcessGroup, executable_path, share_folder

SLEEPER = "import signal, sys, time\n{handlers}\nprint('ready', flush=True)\ntime.sleep(60)\n"


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package `fake` with executables written by the test."""
    prefix = tmp_path / "prefix"
    index = prefix / "share/ament_index/resource_index/packages"
    index.mkdir(parents=True)
    (index / "fake").touch()
    (prefix / "lib/fake").mkdir(parents=True)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(prefix))

    def add(name, code):
        path = prefix / "lib/fake" / name
        path.write_text(f"#!{sys.executable}\n{code}")
        path.chmod(0o755)
        return path

    return add


def ready(process):
    deadline = time.monotonic() + 30
    while "ready" not in process.output():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


@pytest.mark.parametrize(
    ("handlers", "code"),
    [
        ("signal.signal(signal.SIGINT, lambda *_: sys.exit(0))", 0),
        ("signal.signal(signal.SIGINT, signal.SIG_IGN); signal.signal(signal.SIGTERM, lambda *_: sys.exit(3))", 3),
        (
            "signal.signal(signal.SIGINT, signal.SIG_IGN); signal.signal(signal.SIGTERM, signal.SIG_IGN)",
            -signal.SIGKILL,
        ),
    ],
    ids=["polite", "stubborn", "deaf"],
)
def test_a_process_is_ended_by_the_gentlest_signal_that_works(package, tmp_path, handlers, code):
    package("sleeper", SLEEPER.format(handlers=handlers))
    with ProcessGroup(os.environ, tmp_path / "logs") as group:
        process = group.start(Executable("fake", "sleeper"))
        ready(process)
        assert group.stop(timeout=0.5) == {"sleeper": code}
    assert not alive(process.pid)


def test_what_a_child_started_ends_too(package, tmp_path):
    package(
        "parent",
        "import subprocess, sys, time\n"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'])\n"
        "print('ready', child.pid, flush=True)\ntime.sleep(60)\n",
    )
    with ProcessGroup(os.environ, tmp_path / "logs") as group:
        process = group.start(Executable("fake", "parent"))
        ready(process)
        grandchild = int(process.output().split()[1])
    time.sleep(0.2)
    assert not alive(grandchild)


def test_children_end_when_their_owner_is_killed(package, tmp_path):
    package("sleeper", SLEEPER.format(handlers=""))
    code = (
        "import os, sys, time\nfrom pathlib import Path\nfrom sl_bringup.processes import Executable, ProcessGroup\n"
        f"group = ProcessGroup(os.environ, Path({str(tmp_path)!r}))\n"
        "print(group.start(Executable('fake', 'sleeper')).pid, flush=True)\ntime.sleep(60)\n"
    )
    owner = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    pid = int(owner.stdout.readline())
    assert alive(pid)
    owner.kill()
    owner.wait(10)
    deadline = time.monotonic() + 5
    while alive(pid):
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_an_ended_process_is_reported_with_its_last_line(package, tmp_path):
    package("failing", "import sys\nsys.exit('error: the reason')\n")
    with ProcessGroup(os.environ, tmp_path / "logs") as group:
        process = group.start(Executable("fake", "failing"))
        process.wait(30)
        with pytest.raises(ProcessError, match="failing ended with exit code 1: error: the reason"):
            group.check()


def test_parameters_reach_the_command_line_in_ros_words(package):
    path = package("node", "")
    what = Executable(
        "fake",
        "node",
        parameters={"text": "1.0", "quote": "it's", "flag": True, "rate": 2.0, "list": [1.0, 2.0]},
        remaps={"a": "b"},
        arguments=["--x"],
    )
    assert what.command() == [
        str(path), "--x", "--ros-args",
        "-p", "text:='1.0'", "-p", "quote:='it''s'", "-p", "flag:=true", "-p", "rate:=2.0", "-p", "list:=[1.0, 2.0]",
        "-r", "a:=b",
    ]  # fmt: skip


def test_what_is_not_installed_is_named(package):
    package("node", "")
    with pytest.raises(ProcessError, match="package 'nothing'"):
        executable_path("nothing", "node")
    with pytest.raises(ProcessError, match="no executable 'other'"):
        executable_path("fake", "other")
    assert share_folder("fake").name == "fake"


def test_domains_are_handed_out_once():
    with free_domain() as first, free_domain() as second:
        assert first != second
        assert {first, second} <= set(DOMAINS)
        assert environment(first)["ROS_DOMAIN_ID"] == str(first)
        assert environment(first)["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    with pytest.raises(ValueError, match="passed through"), free_domain():
        raise ValueError("passed through")
    with free_domain(7) as wanted:
        assert wanted == 7
