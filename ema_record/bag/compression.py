"""Unpacking of compressed data with a bound: what is larger than it says is refused."""

from __future__ import annotations

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from ema_record.errors import InvalidRecordError


def unpack(data: bytes, method: str, size: int, where: str) -> bytes:
    """Return compressed data unpacked.

    Parameters
    ----------
    data : one frame.
    method : ``""`` (none), ``zstd`` or ``lz4``.
    size : its size when unpacked, as its container says; already checked to be acceptable.
    where : named in errors.

    Raises
    ------
    InvalidRecordError
        Damaged, of another size, or a method that is not known.
    """
    try:
        if method == "":
            result = data
        elif method == "zstd":
            result = _unpack_zstd(data, size, where)
        elif method == "lz4":
            result = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
        else:
            raise InvalidRecordError(
                f"{where}: compression {method[:20]!r} is not known (none, lz4, zstd): "
                "convert the bag with 'mcap compress --compression zstd'"
            )
    except (zstandard.ZstdError, RuntimeError, MemoryError, EOFError) as error:
        raise _damaged(where, method, error) from None
    if len(result) != size:
        raise InvalidRecordError(
            f"{where}: unpacks to {f'more than {size}' if len(result) > size else len(result)} "
            f"bytes, announced are {size}: damaged, or made to exhaust the memory"
        )
    return result


def _damaged(where: str, method: str, error: Exception) -> InvalidRecordError:
    said = (str(error) or type(error).__name__).splitlines()[0][:80]
    return InvalidRecordError(f"{where}: {method} data are damaged ({said}): copy the file again "
                              "from where it was recorded")


def _unpack_zstd(data: bytes, size: int, where: str) -> bytes:
    """Unpack one frame; its own announcement is compared before memory is taken for it."""
    announced = zstandard.frame_content_size(data)
    if announced not in (-1, size):
        raise InvalidRecordError(
            f"{where}: its zstd frame announces {announced} bytes, its record {size}: damaged, "
            "or made to exhaust the memory"
        )
    if size == 0:
        return b""
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)


def unpack_zstd_stream(data: bytes, bound: int, where: str) -> bytes:
    """Return a zstd stream unpacked, refusing more than `bound` bytes."""
    try:
        with zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True) as reader:
            result = reader.read(bound + 1)
    except (zstandard.ZstdError, MemoryError) as error:
        raise _damaged(where, "zstd", error) from None
    if len(result) > bound:
        raise InvalidRecordError(f"{where}: unpacks to more than {bound} bytes: split the bag")
    return result


def unpack_zstd_part(data: bytes, bound: int) -> bytes:
    """Return the beginning of a zstd stream, as far as it goes, at most `bound` bytes."""
    parts: list[bytes] = []
    total = 0
    try:
        with zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True) as reader:
            while total < bound:
                part = reader.read(min(1 << 16, bound - total))
                if not part:
                    break
                parts.append(part)
                total += len(part)
    except zstandard.ZstdError:
        pass  # what came before the damage stays
    return b"".join(parts)
