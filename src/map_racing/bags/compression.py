"""Decompression of the contents of bags, as far as possible."""

from __future__ import annotations

import bz2
import logging
from functools import lru_cache

import lz4.frame

__all__ = ["COMPRESSIONS", "ZSTD_MAGIC", "decompress", "decompress_message", "zstd_decompressor"]

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

_BLOCK = 4096


@lru_cache(maxsize=None)
def _zstd():
    """Function that makes a decompressor, function that decompresses, and whether that is fast."""
    # Rarely needed, and slow to import. rosbags brings one; which one depends on its version.
    # zstandard comes first: it makes one context for all messages, which takes a tenth of the time.
    try:
        import zstandard

        decompressor = zstandard.ZstdDecompressor()
        return decompressor.decompressobj, decompressor.decompress, True
    except ImportError:
        pass
    try:
        from compression import zstd
    except ImportError:
        from backports import zstd
    return zstd.ZstdDecompressor, zstd.decompress, False


def zstd_decompressor():
    """An object with ``decompress(block)`` and ``eof`` for one frame of zstd."""
    return _zstd()[0]()


@lru_cache(maxsize=None)
def _message_decompressor():
    _, whole, fast = _zstd()
    if not fast:  # logged once, not noted with the bag: it concerns this computer
        logging.getLogger(__name__).warning(
            "a bag compressed message by message is read about four times as fast with zstandard: "
            "pip install 'map_racing[zstd]'"
        )
    return whole


def decompress_message(data: bytes) -> bytes:
    """Decompress a single zstd-compressed message as far as possible."""
    # Making a streaming decompressor takes as long as decompressing a hundred messages.
    try:
        return _message_decompressor()(data)
    except MemoryError:
        raise
    except Exception:
        return decompress("zstd", data)[0]


_DECOMPRESSORS = {
    "bz2": bz2.BZ2Decompressor,
    "lz4": lz4.frame.LZ4FrameDecompressor,
    "zstd": zstd_decompressor,
}
COMPRESSIONS = ("", "none", *_DECOMPRESSORS)
"""Names of the compressions that `decompress` reads."""


def decompress(compression: str, data: bytes) -> tuple[bytes, bool]:
    """Decompress the contents of a chunk.

    Parameters
    ----------
    compression : str
        ``bz2``, ``lz4`` or ``zstd``; ``none`` or empty for none.
    data : bytes

    Returns
    -------
    contents : bytes
        As far as they can be decompressed.
    sound : bool
        Whether that is all.
    """
    if compression in ("", "none"):
        return data, True
    make = _DECOMPRESSORS.get(compression)
    if make is None:
        return b"", False
    decompressor = make()
    # For damaged data, each library raises its own classes.
    try:
        contents = decompressor.decompress(data)
        if decompressor.eof:
            return contents, True
    except MemoryError:
        raise
    except Exception:
        pass
    decompressor, contents = make(), []
    try:
        for at in range(0, len(data), _BLOCK):
            contents.append(decompressor.decompress(data[at : at + _BLOCK]))
    except MemoryError:
        raise
    except Exception:
        pass
    return b"".join(contents), False
