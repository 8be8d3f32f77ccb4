"""Unpacking is limited, per piece and in total: the size that a file declares is no proof."""

import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, Final

import lz4.frame
import zstandard
from mcap.records import Chunk

from hilserver.errors import LogError

# of a chunk, a message, a blob; recorders write chunks of a few MB
PIECE_BYTES: Final = 1 << 28
FREE_BYTES: Final = 1 << 28
# of messages in total; a diagnosis of eight hours at 100 Hz needs less
KEPT_BYTES: Final = 1 << 31
RATIO: Final = 1000
"""Beyond `FREE_BYTES`, largest size relative to the file; a robot at rest packs 350 to 1."""

ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"


class Budget:
    """How much a file may still unpack to."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._left = FREE_BYTES + RATIO * path.stat().st_size
        self._kept = 0

    def take(self, n_bytes: int) -> None:
        """Count bytes that are or would be unpacked; LogError if there are too many."""
        self._left -= n_bytes
        if self._left < 0 or n_bytes > PIECE_BYTES:
            size = self._path.stat().st_size
            raise LogError(
                f"{self._path}: its {size / 1e6:.3g} MB expand to far more than a recording"
                " would; if it is one, split it into shorter files"
            )

    def keep(self, n_bytes: int) -> None:
        """Count bytes that stay in memory; LogError if there are too many."""
        self._kept += n_bytes
        if self._kept > KEPT_BYTES or n_bytes > PIECE_BYTES:
            raise LogError(
                f"{self._path}: its mapped topics contain more than {KEPT_BYTES >> 30} GB, or a"
                f" message more than {PIECE_BYTES >> 20} MB; map only topics with numbers, or"
                " split the bag"
            )

    def unzstd_file(self, path: Path, plain: Path) -> None:
        """Unpack a file."""
        with path.open("rb") as packed, plain.open("wb") as out:
            out.writelines(self._pieces(packed))

    def unzstd(self, data: bytes, most: int = PIECE_BYTES) -> bytes:
        """Unpack zstd, hardly more than `most` bytes, whatever size the frame declares."""
        result = bytearray()
        for piece in self._pieces(BytesIO(data)):
            result += piece
            if len(result) > most:
                break
        return bytes(result)

    def _pieces(self, packed: IO[bytes]) -> Iterator[bytes]:
        for piece in zstandard.ZstdDecompressor().read_to_iter(packed):
            self.take(len(piece))
            yield piece

    def unpack(self, chunk: Chunk) -> bytes:
        """Return the records in a chunk of MCAP.

        ValueError if it does not hold what it declares.
        """
        most = chunk.uncompressed_size
        if most > PIECE_BYTES:
            self.take(most)
        if chunk.compression == "zstd":
            data = self.unzstd(chunk.data, most)
        elif chunk.compression == "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(
                chunk.data, max_length=most + 1
            )
            self.take(len(data))
        elif chunk.compression == "":
            data = chunk.data
        else:
            raise ValueError(f"has unknown compression {chunk.compression}")
        if len(data) != most:
            raise ValueError("does not have the size that it declares")
        if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
            raise ValueError("has a wrong checksum")
        return data
