"""Writing rclpy messages to an MCAP bag."""

import queue
import threading
from pathlib import Path
from types import TracebackType
from typing import Any

from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from sl_bringup.bag.types import qos, serialise, type_name, typestore
from sl_bringup.errors import BagError


class BagWriter:
    """An MCAP bag under construction: a folder with the .mcap file, compressed with zstd, and metadata.yaml."""

    def __init__(self, folder: Path) -> None:
        """Create the bag ``folder``; raises BagError when it is there already."""
        if folder.exists():
            raise BagError(f"{folder} exists already: a bag is not overwritten, remove it or choose another folder")
        self.folder = folder
        self._writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._connections: dict[str, Connection] = {}
        self.counts: dict[str, int] = {}

    def __enter__(self) -> "BagWriter":
        self._writer.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.close()  # also after an error: what was recorded up to then is what one wants to see

    def write(self, topic: str, message: Any, stamp: int, *, latched: bool = False) -> None:
        """Append a message received at ``stamp`` [ns]; ``latched`` is remembered with the topic's first message."""
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic,
                type_name(type(message)),
                typestore=typestore(),
                offered_qos_profiles=[qos(latched=latched)],
            )
        self._writer.write(self._connections[topic], stamp, serialise(message))
        self.counts[topic] = self.counts.get(topic, 0) + 1


class BackgroundWriter:
    """A BagWriter fed from callbacks that must not wait for the disk or the compression."""

    def __init__(self, folder: Path) -> None:
        self._bag = BagWriter(folder)
        self._queue: queue.Queue[tuple[str, Any, int, bool] | None] = queue.Queue()
        self._thread = threading.Thread(target=self._run, name="bag writer", daemon=True)
        self._error: Exception | None = None
        self._thread.start()

    @property
    def counts(self) -> dict[str, int]:
        """Messages written by topic."""
        return dict(self._bag.counts)

    def write(self, topic: str, message: Any, stamp: int, *, latched: bool = False) -> None:
        """Queue a message received at ``stamp`` [ns]."""
        self._queue.put((topic, message, stamp, latched))

    def close(self) -> None:
        """Write what is queued and finish the bag; raises BagError when writing failed."""
        self._queue.put(None)
        self._thread.join()
        if self._error is not None:
            raise BagError(f"the bag {self._bag.folder} is incomplete: {self._error}")

    def _run(self) -> None:
        try:
            with self._bag:
                while (item := self._queue.get()) is not None:
                    topic, message, stamp, latched = item
                    self._bag.write(topic, message, stamp, latched=latched)
        except Exception as error:  # the owner asks for it in close()
            self._error = error
