"""The checksums of all written data, which are stored and compared with what is read back."""

import zlib
from collections.abc import Callable
from typing import Any

import numpy as np


def checksum(values: np.ndarray) -> int:
    if values.dtype.kind not in "biufc":  # strings
        return zlib.crc32(repr([str(value) for value in values.ravel()]).encode())
    return zlib.crc32(np.ascontiguousarray(values).data)


def sealed(sums: list[int]) -> list[int]:
    """Checksums followed by their own nonzero checksum; neither zeros nor a torn record are a valid commit."""
    return [*sums, zlib.crc32(np.array(sums, np.uint32).tobytes()) or 1]


def found(array: Callable[[], Any], *place: int | slice) -> int | None:
    """The checksum of an array of a store at a place, by default of all of it; None if the array cannot be read.

    The last chunks of an array may extend beyond its end. The padding there is never read, but if a byte of it has
    changed, the file is damaged.
    """
    values = or_none(lambda: _whole_at(array(), place))
    return None if values is None else checksum(np.asarray(values))


def or_none(read: Callable[[], Any]) -> Any:
    try:
        return read()
    except Exception:  # reading a damaged file can raise anything
        return None


def _whole_at(array: Any, place: tuple[int | slice, ...]) -> Any:
    """The values of an array at a place made of whole chunks; None if the padding beyond its end is damaged."""
    ends = tuple(-(-length // size) * size for length, size in zip(array.shape, array.chunks, strict=True))
    if not place or ends == array.shape:
        return array[place or ...]
    import zarr

    longer = zarr.Array(zarr.AsyncArray(array.metadata.update_shape(ends), array.store_path))
    inner = [slice(at, at + 1) if isinstance(at, int) else at for at in place]
    outer = [slice(at.start, -(-at.stop // size) * size) for at, size in zip(inner, array.chunks, strict=False)]
    chunks: Any = longer[tuple(outer)]
    inside = tuple(slice(at.stop - at.start) for at in inner)
    for axis, at in enumerate(inside):
        beyond = chunks[(*[slice(None)] * axis, slice(at.stop, None))]
        if checksum(beyond) != checksum(np.full_like(beyond, array.fill_value)):
            return None
    return chunks[inside]
