"""README.md says of every node what the running node says of itself."""

import pytest
from node_reference import NODES, README, describe_node, section


@pytest.mark.processes
@pytest.mark.parametrize("node", NODES)
def test_reference_of_a_node_is_up_to_date(node, tmp_path):
    documented = section(README.read_text(), node)
    assert documented == describe_node(node, tmp_path), "run: python tests/node_reference.py"
    assert f"ros2 run {NODES[node]} {node}" in README.read_text()
