import os

import pytest

# Discovery stays on this machine, also for the nodes that a test creates in its own process.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"


@pytest.fixture
def stack(tmp_path):
    """Real processes in a ROS domain of their own; none is left behind."""
    from stack_testing.running import running_stack

    with running_stack(tmp_path) as running:
        yield running
        processes = running.group.processes
    assert all(p.returncode is not None for p in processes)
