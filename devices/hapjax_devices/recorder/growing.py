"""An MCAP file that grows, and is whole up to its last batch at any time."""

import json
import os
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path

from hapjax import InputError
from hapjax.extras import need

from ..bus import About
from .messages import Message

_LARGEST = 8 * 2**20  # bytes of a chunk; batches are far smaller
_MESH = "application/octet-stream"


class GrowingFile:
    """Writes messages in batches, each of which is in the file when `save` returns.

    After a failure (a full disk, say) the file ends with the last whole batch: it can be read, and `hapjax recover` gives it
    its end.

    **Arguments:** `path` of the new file; `about` the run; `schemas`, name and JSON schema of each topic.

    **Raises:** `InputError` where there is a file already, or none can be made, for want of room too.
    """

    def __init__(self, path: Path, about: About, schemas: dict[str, tuple[str, bytes]]):
        writers = need("mcap.writer", "devices")
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        except FileExistsError:
            raise InputError(f"{path}: exists; allowed: a recording with a new name") from None
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"{path}: cannot be made: {reason}") from None
        self._path, self._batch, self._good = path, _Batch(), 0
        self._writer = writers.Writer(self._batch, chunk_size=_LARGEST)
        self._writer.start(profile="", library="hapjax")
        self._describe(about)
        self._ids = {}
        for topic, (name, schema) in schemas.items():
            place = self._writer.register_schema(name, "jsonschema", schema)
            self._ids[topic] = self._writer.register_channel(topic, "json", place)
        self._sequence = 0
        try:
            self.save(())
        except OSError as error:
            path.unlink(missing_ok=True)  # there is nothing in it
            raise InputError(f"{path}: cannot be made: {error.strerror or error}") from None

    def save(self, messages: Iterable[Message]) -> None:
        """Write a batch of messages. **Raises:** `OSError`; the batch is then left out, and the file closed."""
        for topic, time_ns, data in messages:
            self._writer.add_message(self._ids[topic], time_ns, data, time_ns, self._sequence)
            self._sequence += 1
        self._writer.flush()
        self._put()

    def finish(self) -> None:
        """Write the index, and close the file. **Raises:** `OSError`; the file is then without its index, and closed."""
        self._writer.finish()
        self._put()
        os.close(self._file)

    def _describe(self, about: About) -> None:
        begun = datetime.fromtimestamp(about.wall_ns * 1e-9, UTC).isoformat()
        said = {"run": about.run, "rate": repr(about.rate), "began": begun, "dtype": about.dtype}
        said |= {"wall_start_ns": str(about.wall_ns), "clock_start_ns": str(about.clock_ns)}
        said |= {"no_scene": about.unsaid} if about.unsaid else {}
        self._writer.add_metadata("hapjax.run", said | {"objects": json.dumps(about.objects)})
        attached = [("devices.json", "application/json", json.dumps(about.devices, indent=2).encode())]
        if about.scene:
            attached.append(("scene.toml", "application/toml", about.scene.encode()))
        for name, place in about.files.items():
            try:
                attached.append((name, _MESH, Path(place).read_bytes()))
            except OSError:
                continue  # it was there when the scene was loaded
        for name, kind, data in attached:
            self._writer.add_attachment(about.wall_ns, about.wall_ns, name, kind, data)

    def _put(self) -> None:
        data = memoryview(self._batch.take())
        try:
            while data:
                data = data[os.write(self._file, data) :]
        except OSError as error:
            os.ftruncate(self._file, self._good)
            os.close(self._file)
            error.filename = str(self._path)
            raise
        self._good = self._batch.before


class _Batch:
    """What the writer has written and the file has not."""

    def __init__(self):
        self.before, self._waiting = 0, bytearray()

    def write(self, data: bytes) -> int:
        self._waiting += data
        return len(data)

    def tell(self) -> int:
        return self.before + len(self._waiting)

    def flush(self) -> None:
        """There is nothing to be done: what is written waits to be taken."""

    def take(self) -> bytearray:
        """What waits; none of it does any more."""
        self.before, taken = self.tell(), self._waiting
        self._waiting = bytearray()
        return taken
