"""Logs from and to a browser: bounded, streamed, never overwriting an existing one."""

import asyncio
import codecs
import os
import shutil
import tempfile
from pathlib import Path
from typing import IO

from aiohttp import web

from hilserver.io.page.files import LOG_SUFFIXES, file_in, is_plain
from hilserver.io.page.hand import RefusedError
from hilserver.io.places import KeptPlace, PlaceKeeper
from hilserver.time_limit import time_limit

MAX_BYTES = 1 << 30
KEPT_FREE_BYTES = 1 << 30
PIECE_BYTES = 1 << 18
PIECE_S = 30.0
UPLOADS_AT_ONCE = 2
PROGRESS_BYTES = 1 << 16
HEAD_BYTES = 1 << 16
LEAST_LINES = 3  # a header and two rows
BEGINNINGS = {
    ".mcap": ("an MCAP", b"\x89MCAP0\r\n"),
    ".parquet": ("a Parquet", b"PAR1"),
    ".db3": ("an SQLite", b"SQLite format 3\0"),
}
"""An upload that takes longer than `hilserver.io.places.YIELDS_AFTER_S` for so many makes room."""
_Part = IO[bytes]


class Uploads:
    """Takes logs into a folder, a few at a time."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._places = PlaceKeeper(UPLOADS_AT_ONCE)

    def download(self, name: str) -> web.FileResponse:
        """Return a log; RefusedError if there is none."""
        path = file_in(self._folder, name)
        return web.FileResponse(
            path,
            headers={
                "Content-Type": "application/octet-stream",
                "Content-Disposition": f'attachment; filename="{path.name}"',
            },
        )

    async def take(self, name: str, request: web.Request) -> int:
        """Store the content of a request; return its size in bytes.

        RefusedError if the name is taken or not a log's, the content is none of that kind, others
        are uploaded, or it is too large.
        """
        if not is_plain(name) or Path(name).suffix not in LOG_SUFFIXES:
            raise RefusedError(
                f"{name!r:.60} is not a log name: letters, digits, _ . - and one of"
                f" {', '.join(LOG_SUFFIXES)}"
            )
        slow = RefusedError("another log took its place, as this one came too slowly")
        place = self._places.take(
            request.remote or "", lambda: request.content.set_exception(slow)
        )
        if place is None:
            raise RefusedError(
                "other logs are being uploaded; wait until one is complete"
            )
        target = self._folder / name
        try:
            part = await asyncio.to_thread(self._begin, target)
            with part:
                size = await self._copy(request, part, place)
                await asyncio.to_thread(_refuse_what_is_no_log, part, target)
                await asyncio.to_thread(_complete, part, target)
        except FileExistsError:
            raise RefusedError(
                f"a log '{name}' already exists; give this one another name"
            ) from None
        except OSError as error:
            raise RefusedError(f"{name} cannot be stored: {error.strerror}") from None
        finally:
            self._places.leave(place)
        return size

    def _begin(self, target: Path) -> _Part:
        self._folder.mkdir(parents=True, exist_ok=True)
        if target.exists():
            raise FileExistsError
        return tempfile.NamedTemporaryFile(prefix=".upload-", dir=self._folder)

    async def _copy(self, request: web.Request, part: _Part, place: KeptPlace) -> int:
        room = min(MAX_BYTES, shutil.disk_usage(self._folder).free - KEPT_FREE_BYTES)
        size = reached = 0
        self._places.progress(place)
        while True:
            try:
                async with time_limit(PIECE_S):
                    piece = await request.content.read(PIECE_BYTES)
            except TimeoutError:
                raise RefusedError("the log did not arrive completely") from None
            if not piece:
                return size
            size += len(piece)
            if size - reached >= PROGRESS_BYTES:
                reached = size
                self._places.progress(place)
            if size > room:
                raise RefusedError(
                    f"the log is larger than the {max(room, 0) >> 20} MB that are free here"
                )
            await asyncio.to_thread(part.write, piece)


def _refuse_what_is_no_log(part: _Part, target: Path) -> None:
    part.seek(0)
    head = part.read(HEAD_BYTES)
    is_whole = len(head) < HEAD_BYTES
    part.seek(0, os.SEEK_END)
    if not head.strip():
        raise RefusedError(f"{target.name} is empty")
    if target.suffix in BEGINNINGS:
        kind, beginning = BEGINNINGS[target.suffix]
        if not head.startswith(beginning):
            raise RefusedError(f"{target.name} is not {kind} file: it begins otherwise")
        return
    if b"\0" in head and not head.startswith(
        (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    ):
        raise RefusedError(f"{target.name} is not a text: a CSV log is one")
    if is_whole and sum(map(bool, map(bytes.strip, head.splitlines()))) < LEAST_LINES:
        raise RefusedError(
            f"{target.name} holds no series: a log has a header and at least two rows"
        )


def _complete(part: _Part, target: Path) -> None:
    part.flush()
    os.fchmod(part.fileno(), 0o644)
    os.link(part.name, target)  # fails if another upload was faster
