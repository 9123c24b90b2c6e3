"""The messages of an MCAP file, one after the other, of a damaged one as far as it is whole."""

import io
import mmap
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

from ..errors import InputError
from ..extras import need
from .content import CHUNK_RATIO, UNPACKED_MARGIN, UNPACKED_RATIO, check_unpacked
from .finding import Finding

_SCHEMA, _MESSAGE = 3, 5
_OBJECT = 500  # bytes that a record takes as an object
_ENTRIES = 16  # times as many bytes a channel's entries take as objects
DAMAGE = (ValueError, TypeError, KeyError, struct.error, OverflowError, MemoryError, EOFError, RuntimeError)


class Scan:
    """Goes once through a file from its beginning: (channel, schema or None, message) of each message.

    Not by the index at the end, which a file has only if its writer came to finish it.

    **Raises:** `hapjax.InputError` for what is no MCAP file, a damaged part, and a chunk that would unpack to far
    more than the file's size; `OSError` if it cannot be opened.
    """

    def __init__(self, path: Path):
        need("mcap", "recording")
        self.path, self.size = path, path.stat().st_size
        self.messages, self.latest = 0, None
        self._described = Described(path, self.size)
        self._whole = 0  # bytes that were read
        self._ended = False

    def __iter__(self) -> Iterator[tuple]:
        records = need("mcap.records", "recording")
        schemas, channels = {}, {}
        for record in self._records():
            if isinstance(record, records.Schema):
                schemas[record.id] = record
            elif isinstance(record, records.Channel):
                channels[record.id] = record
            elif isinstance(record, records.Message):
                channel = channels.get(record.channel_id)
                if channel is None:
                    raise self._damaged(f"a message of channel {record.channel_id}, which was not described")
                self.messages += 1
                yield channel, schemas.get(channel.schema_id), record

    def attachments(self) -> Iterator:
        """The attachments, instead of the messages; chunks are passed over."""
        kind = need("mcap.records", "recording").Attachment
        return (record for record in self._records(unpack=False) if isinstance(record, kind))

    def findings(self) -> tuple[Finding, ...]:
        """What there is to say of the file after it was gone through: whether its end was missing."""
        if self._ended:
            return ()
        sentence = (
            f"the file ends in the middle ({self.size - self._whole} of {self.size} bytes are no whole part): "
            f"its writer was stopped or the file was cut short; {self.messages} messages were read"
        )
        return (Finding("file", "cut short", sentence, "read up to the last whole part"),)

    def _records(self, unpack: bool = True) -> Iterator:
        """All records, those in chunks too; or the chunks as they are."""
        if self.size == 0:
            raise InputError(f"{self.path}: expected an MCAP file, found an empty one")
        errors, kinds = need("mcap.exceptions", "recording"), need("mcap.records", "recording")
        with open(self.path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as stream:
            reader = self._reader(stream, self.size, emit_chunks=True)
            try:
                for record in reader.records:
                    if unpack and isinstance(record, kinds.Chunk):
                        yield from self._unpacked(record)
                    else:
                        yield record
                    self._whole = stream.tell()
                    if isinstance(record, kinds.DataEnd):
                        break  # what follows is an index
                self._ended = True
            except errors.InvalidMagic:
                raise InputError(f"{self.path}: expected an MCAP file, found another format") from None
            except (errors.EndOfFile, errors.RecordLengthLimitExceeded):
                if self._whole == 0:
                    raise InputError(
                        f"{self.path}: expected an MCAP file, found another format or nothing whole"
                    ) from None
            except (errors.McapError, *DAMAGE) as error:
                if isinstance(error, InputError):
                    raise
                if self._runs_out(stream):
                    return
                raise self._damaged(str(error) or type(error).__name__) from error

    def _runs_out(self, stream) -> bool:
        """Whether the record that begins where the whole ones end goes on beyond the end of the file."""
        head = stream[self._whole + 1 : self._whole + 9]
        return self._whole > 0 and (
            len(head) < 8 or self._whole + 9 + struct.unpack("<Q", head)[0] > self.size
        )

    def _reader(self, stream, size: int, **options):
        readers = need("mcap.stream_reader", "recording")
        return readers.StreamReader(stream, record_size_limit=size, **options)

    def _unpacked(self, chunk) -> Iterator:
        """The records of a chunk."""
        errors = need("mcap.exceptions", "recording")
        check_unpacked(self.path, self.size, chunk.uncompressed_size, CHUNK_RATIO)
        data = decompressed(chunk)
        if len(data) != chunk.uncompressed_size:
            raise self._damaged("a chunk of another length than it says")
        if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
            raise self._damaged("a chunk with a wrong checksum")
        self._described.add(data)
        stream = io.BytesIO(data)
        try:
            yield from self._reader(stream, len(data), skip_magic=True).records
        except errors.EndOfFile:
            if stream.tell() != len(data):
                raise
        except errors.RecordLengthLimitExceeded:
            raise self._damaged("a chunk with a record longer than itself") from None

    def _damaged(self, what: str) -> InputError:
        where = f"{self.path}, after {self.messages} messages, at byte {self._whole}"
        return InputError(f"{where}: expected a whole MCAP file, found {what[:200]}")


class Described:
    """The room that what describes the messages of a file takes: the schema or channel of each number stays."""

    def __init__(self, path: Path, size: int):
        self._path, self._most = path, UNPACKED_RATIO * size + UNPACKED_MARGIN
        self._rooms: dict[bytes, int] = {}
        self._room = 0

    def add(self, data: bytes) -> None:
        """Count the records of a chunk. **Raises:** `hapjax.InputError` before they take far more than the file's size."""
        place = 0
        while place + 9 < len(data):
            kind, length = struct.unpack_from("<BQ", data, place)
            if kind != _MESSAGE:
                name = data[place : place + 1] + data[place + 9 : place + 11]  # its kind and number
                room = _OBJECT + length * (1 if kind == _SCHEMA else _ENTRIES)
                self._room += max(room - self._rooms.get(name, 0), 0)
                self._rooms[name] = max(room, self._rooms.get(name, 0))
            if self._room > self._most:
                problem = f"expected schemas and channels that take at most {self._most} bytes, found more"
                raise InputError(f"{self._path}: {problem}")
            place += 9 + length


def decompressed(chunk) -> bytes:
    """The bytes of a chunk; of a bomb not more than it says."""
    if chunk.compression == "":
        return chunk.data
    if chunk.compression == "zstd":
        zstandard = need("zstandard", "recording")
        try:
            if zstandard.frame_content_size(chunk.data) > chunk.uncompressed_size:
                raise ValueError("a chunk that is longer than it says")
            return zstandard.decompress(chunk.data, chunk.uncompressed_size)
        except zstandard.ZstdError as error:
            raise ValueError(f"a damaged chunk: {error}") from None
    if chunk.compression == "lz4":
        lz4 = need("lz4.frame", "recording")
        return lz4.LZ4FrameDecompressor().decompress(chunk.data, max_length=chunk.uncompressed_size)
    raise ValueError(f"a chunk compressed by {chunk.compression[:40]!r}; allowed: zstd, lz4")
