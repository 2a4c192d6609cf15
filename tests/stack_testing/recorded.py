"""The bag that the project ships, as messages and truth."""

import json
from collections import defaultdict
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message

from sl_bringup.bag.reader import BagReader
from sl_bringup.ros.player import message_class

ROOT = Path(__file__).resolve().parents[2]
WAVY = ROOT / "bags" / "wavy"


@cache
def serialised(folder: Path = WAVY) -> dict[str, list[tuple[int, Any, bytes]]]:
    """Return stamp [ns], message class and bytes by topic."""
    out: dict[str, list[tuple[int, Any, bytes]]] = defaultdict(list)
    with BagReader(folder / "bag") as bag:
        classes = {t.name: message_class(t) for t in bag.topics}
        for topic, stamp, data in bag.messages():
            out[topic].append((stamp, classes[topic], data))
    return dict(out)


def messages(topic: str, folder: Path = WAVY) -> list[Any]:
    """Return fresh copies of a topic's messages."""
    return [deserialize_message(data, kind) for _, kind, data in serialised(folder)[topic]]


def spots(folder: Path = WAVY) -> np.ndarray:
    """Return the true place (rows, cols, 3) of each spot in the base frame [m]."""
    return np.load(folder / "spots.npy").astype(np.float64)


def camera_poses(folder: Path = WAVY) -> dict[int, np.ndarray]:
    """Return the true base_from_camera (4, 4) by image stamp [ns]."""
    poses = json.loads((folder / "truth.json").read_text())["base_from_camera"]
    return {int(stamp): np.array(pose) for stamp, pose in poses.items()}
