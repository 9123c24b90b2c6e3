"""Makes a whole MCAP file of one that was cut short or is damaged."""

import io
import mmap
import os
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..extras import need
from ..files import replacing
from .content import CHUNK_RATIO, check_unpacked
from .mcap_records import DAMAGE, Described, decompressed

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = 9  # bytes before a record's own: its kind and its length
_CHUNK, _DATA_END = 6, 15
# What stands in a chunk 28 bytes after its beginning, by which one is found again behind a damaged place.
_COMPRESSIONS = tuple(struct.pack("<I", len(name)) + name for name in (b"zstd", b"lz4"))
_BEFORE_COMPRESSION = _HEAD + 28


@dataclass
class Recovery:
    """What `recover` found: how many `messages` of each topic are in the new file, whether the old one was `whole`, and a
    sentence for each thing that was `lost`."""

    messages: Counter[str] = field(default_factory=Counter)
    lost: list[str] = field(default_factory=list)
    whole: bool = False


def recover(path: Path, out: Path, advance: Callable[[str, float], Any] = lambda *_: None) -> Recovery:
    """Write all that is whole in an MCAP file to a new one, with an index and an end. `path` stays as it is.

    **Arguments:** `advance` is told a hundred times at most what is done, and how much of the whole since it was last told.

    **Raises:** `InputError` for what cannot be read, is no MCAP file or has nothing whole in it, a chunk that would unpack
    to far more than the file's size, and an `out` that is there already or cannot be written.
    """
    writers = need("mcap.writer", "recording")
    if out.exists():
        raise InputError(f"{out}: exists; allowed: a new name for the whole file")
    with _mapped(path) as data:
        if data[: len(_MAGIC)] != _MAGIC:
            raise InputError(f"{path}: expected an MCAP file, found another format")
        with replacing(out, "wb") as new:
            copy = _Copy(path, data, writers.Writer(new, chunk_size=2**20))
            copy.run(advance)
            if not copy.found.messages and not copy.other:
                raise InputError(f"{path}: expected something whole in it, found nothing")
        return copy.found


def _mapped(path: Path) -> mmap.mmap:
    try:
        with open(path, "rb") as file:
            size = os.fstat(file.fileno()).st_size
            if size < len(_MAGIC):
                raise InputError(f"{path}: expected an MCAP file, found {size} bytes")
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error


class _Copy:
    """Goes through the records of a file, and writes what is whole to another."""

    def __init__(self, path: Path, data: mmap.mmap, writer: Any):
        self._path, self._data, self._writer = path, data, writer
        self._records = need("mcap.records", "recording")
        self._schemas, self._known = _described(data)
        self._channels: dict[int, tuple[int, str]] = {}  # the new file's number of each, and its topic
        self._placed: dict[int, int] = {0: 0}  # the new file's number of each schema
        self._told = Described(path, len(data))
        self._unknown = 0
        self._started = False
        self.found, self.other = Recovery(), 0

    def run(self, advance: Callable[[str, float], Any]) -> None:
        """Copy, from the beginning to the end."""
        place = told = len(_MAGIC)
        size = len(self._data)
        while place < size:
            end = self._end(place)
            if end is None:
                place = self._resume(place)
                continue
            if self._data[place] == _DATA_END:
                self.found.whole = self._data[-len(_MAGIC) :] == _MAGIC and not self.found.lost
                break
            self._copy(place, end)
            place = end
            if place - told > size / 100:
                advance("recovering", (place - told) / size)
                told = place
        if not self.found.whole and not self.found.lost:
            self.found.lost.append("the end: its writer was stopped, or it was cut, between two parts")
        if self._unknown:
            self.found.lost.append(f"{self._unknown} messages of topics that are described in what was lost")
        self._start("", "hapjax")
        self._writer.finish()

    def _end(self, place: int) -> int | None:
        """Where the record at `place` ends; `None` where there is none that could be."""
        head = self._data[place : place + _HEAD]
        if len(head) < _HEAD or head[0] == 0:
            return None
        end = place + _HEAD + struct.unpack("<Q", head[1:])[0]
        return end if end <= len(self._data) else None

    def _resume(self, place: int) -> int:
        """Where the next chunk begins behind `place`, where nothing whole does."""
        start = place
        while True:
            found = [self._data.find(words, start + 1 + _BEFORE_COMPRESSION) for words in _COMPRESSIONS]
            starts = [at - _BEFORE_COMPRESSION for at in found if at >= 0]
            if not starts:
                self.found.lost.append(f"the last {len(self._data) - place} bytes: no whole part")
                return len(self._data)
            start = min(starts)
            if self._data[start] == _CHUNK and self._end(start) is not None:
                self.found.lost.append(f"{start - place} bytes at {place}: damaged")
                return start

    def _copy(self, place: int, end: int) -> None:
        """Write a record, or what is in it."""
        try:
            for record in self._read(self._data[place:end]):
                self._write(record)
        except (need("mcap.exceptions", "recording").McapError, *DAMAGE) as error:
            reason = str(error) or type(error).__name__
            self.found.lost.append(f"{end - place} bytes at {place}: {reason[:100]}")

    def _read(self, data: bytes) -> Iterator[Any]:
        """The records of a part of a file, up to a damaged one, and there an exception."""
        readers, errors = need("mcap.stream_reader", "recording"), need("mcap.exceptions", "recording")
        stream = io.BytesIO(data)
        reader = readers.StreamReader(stream, skip_magic=True, emit_chunks=True, record_size_limit=len(data))
        try:
            yield from reader.records
        except errors.EndOfFile:
            if stream.tell() != len(data):
                raise

    def _write(self, record: Any) -> None:
        kinds, writer = self._records, self._writer
        if isinstance(record, kinds.Header):
            self._start(record.profile, record.library)
            return
        self._start("", "hapjax")
        if isinstance(record, kinds.Chunk):
            self._unpack(record)
        elif isinstance(record, kinds.Schema):
            self._schemas[record.id] = record
        elif isinstance(record, kinds.Channel):
            self._describe(record)
        elif isinstance(record, kinds.Message):
            self._message(record)
        elif isinstance(record, kinds.Attachment):
            writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )
            self.other += 1
        elif isinstance(record, kinds.Metadata):
            writer.add_metadata(record.name, record.metadata)
            self.other += 1

    def _unpack(self, chunk: Any) -> None:
        check_unpacked(self._path, len(self._data), chunk.uncompressed_size, CHUNK_RATIO)
        data = decompressed(chunk)
        if len(data) != chunk.uncompressed_size:
            raise ValueError("a chunk of another length than it says")
        if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
            raise ValueError("a chunk with a wrong checksum")
        self._told.add(data)
        for record in self._read(data):
            self._write(record)

    def _describe(self, channel: Any) -> None:
        if channel.id in self._channels:
            return
        schema = self._schemas.get(channel.schema_id)
        if channel.schema_id not in self._placed and schema is not None:
            place = self._writer.register_schema(schema.name, schema.encoding, schema.data)
            self._placed[channel.schema_id] = place
        number = self._writer.register_channel(
            channel.topic, channel.message_encoding, self._placed.get(channel.schema_id, 0), channel.metadata
        )
        self._channels[channel.id] = number, channel.topic

    def _message(self, message: Any) -> None:
        if message.channel_id in self._known:
            self._describe(self._known.pop(message.channel_id))
        if message.channel_id not in self._channels:
            self._unknown += 1
            return
        number, topic = self._channels[message.channel_id]
        self._writer.add_message(
            number, message.log_time, message.data, message.publish_time, message.sequence
        )
        self.found.messages[topic] += 1

    def _start(self, profile: str, library: str) -> None:
        if not self._started:
            self._writer.start(profile, library)
            self._started = True


def _described(data: mmap.mmap) -> tuple[dict[int, Any], dict[int, Any]]:
    """The schemas and channels that the end of a file repeats, if it has one: the chunk that described them may be lost."""
    readers, errors = need("mcap.reader", "recording"), need("mcap.exceptions", "recording")
    with suppress(errors.McapError, *DAMAGE, OSError):
        summary = readers.SeekingReader(data).get_summary()
        if summary is not None:
            return dict(summary.schemas), dict(summary.channels)
    return {}, {}
