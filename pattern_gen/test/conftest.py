import os
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # brute_force.py


@pytest.fixture(scope="session", autouse=True)
def _own_map_cache(tmp_path_factory):
    """Tests find maps themselves and leave none in the user's cache; the commands they start inherit the folder."""
    before = os.environ.get("XDG_CACHE_HOME")
    os.environ["XDG_CACHE_HOME"] = str(tmp_path_factory.mktemp("cache"))
    yield
    if before is None:
        del os.environ["XDG_CACHE_HOME"]
    else:
        os.environ["XDG_CACHE_HOME"] = before
