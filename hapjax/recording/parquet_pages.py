"""How much the pages of a Parquet file unpack to, by what they say themselves: its end may say less.

A page has a header in Thrift's compact protocol before it, whose second and third field are its sizes.
"""

import mmap

_UNPACKED, _PACKED = 2, 3
_FIXED = {3: 1, 7: 8}  # bytes of a number of this type
_TRUE, _FALSE, _WHOLE, _TEXT, _LISTS, _STRUCT = 1, 2, (4, 5, 6), 8, (9, 10), 12
_DEEPEST = 8


def unpacked(data: mmap.mmap, start: int, length: int) -> int:
    """The bytes that the pages from `start` on unpack to. **Raises:** `ValueError` where there are none."""
    place, total = start, 0
    while place < start + length:
        header = _Header(data, place)
        sizes = header.struct()
        if min(sizes[_UNPACKED], sizes[_PACKED]) < 0:
            raise ValueError("a page of a size below 0")
        total += sizes[_UNPACKED]
        place = header.place + sizes[_PACKED]
    return total


class _Header:
    """Reads one header; `place` is where it has come to."""

    def __init__(self, data: mmap.mmap, place: int):
        self._data, self.place = data, place

    def struct(self, depth: int = 0) -> dict[int, int]:
        """The whole numbers of a struct, by the numbers of their fields."""
        found, field = {}, 0
        while head := self._byte():
            field = field + (head >> 4) if head >> 4 else self._whole()
            value = self._value(head & 15, depth)
            if value is not None:
                found[field] = value
        return found

    def _value(self, kind: int, depth: int) -> int | None:
        if depth > _DEEPEST:
            raise ValueError("a header nested too deep")
        if kind in _WHOLE:
            return self._whole()
        if kind == _STRUCT:
            self.struct(depth + 1)
        elif kind in _FIXED:
            self.place += _FIXED[kind]
        elif kind == _TEXT:
            length = self._varint()
            self.place += length
        elif kind in _LISTS:
            head = self._byte()
            for _ in range(head >> 4 if head >> 4 < 15 else self._varint()):
                self._value(head & 15, depth + 1)
        elif kind not in (_TRUE, _FALSE):
            raise ValueError(f"a field of type {kind}")
        return None

    def _whole(self) -> int:
        number = self._varint()
        return number >> 1 ^ -(number & 1)

    def _varint(self) -> int:
        number = shift = 0
        while (byte := self._byte()) & 128:
            number |= (byte & 127) << shift
            shift += 7
            if shift > 63:
                raise ValueError("a number of over 64 bits")
        return number | byte << shift

    def _byte(self) -> int:
        self.place += 1
        if self.place > len(self._data):
            raise ValueError("a header beyond the end of the file")
        return self._data[self.place - 1]
