"""Reading a bag."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from rosbags.interfaces import Connection, QosDurability
from rosbags.rosbag2 import Reader

from sl_bringup.errors import BagError


@dataclass(frozen=True)
class Topic:
    """A topic of a bag: its name, ROS type, number of messages, and whether it was latched."""

    name: str
    type_name: str
    count: int
    latched: bool


class BagReader:
    """An MCAP (or sqlite3) bag, opened for reading."""

    def __init__(self, folder: Path) -> None:
        """Open a bag's folder, or the folder of the .mcap file given; raises BagError where none is readable."""
        folder = folder.parent if folder.is_file() else folder
        if not (folder / "metadata.yaml").is_file():
            raise BagError(f"{folder} is not a bag: it has no metadata.yaml")
        self.folder = folder
        try:
            self._reader = Reader(folder)
            self._reader.open()
        except Exception as error:  # rosbags raises several kinds for broken files
            raise BagError(f"{folder} cannot be read: {' '.join(str(error).split())}") from None

    def __enter__(self) -> "BagReader":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._reader.close()

    @property
    def start(self) -> int:
        """Stamp of the first message [ns]."""
        return int(self._reader.start_time)

    @property
    def duration(self) -> float:
        """From the first to the last message [s]."""
        return float(self._reader.duration) * 1e-9

    @property
    def topics(self) -> list[Topic]:
        """What the bag holds."""
        return [Topic(c.topic, c.msgtype, c.msgcount, _latched(c)) for c in self._reader.connections]

    def messages(self) -> Iterator[tuple[str, int, bytes]]:
        """Yield topic, stamp [ns] and CDR bytes of every message, oldest first."""
        for connection, stamp, data in self._reader.messages():
            yield connection.topic, stamp, bytes(data)


def _latched(connection: Connection) -> bool:
    profiles = getattr(connection.ext, "offered_qos_profiles", [])
    return any(p.durability == QosDurability.TRANSIENT_LOCAL for p in profiles)
