"""The built page, from the package: read once, compressed once."""

import gzip
import mimetypes
from dataclasses import dataclass
from pathlib import Path

from hilserver.errors import FailedError

FOLDER = Path(__file__).parent / "static"
TOKEN = b"__TOKEN__"
_TEXTS = (".html", ".js", ".css", ".svg", ".json", ".txt", ".webmanifest")


@dataclass(frozen=True)
class Asset:
    """One file of the page."""

    body: bytes
    packed: bytes | None
    content_type: str


def load(folder: Path = FOLDER) -> dict[str, Asset]:
    """Return every file by its path from the folder; FailedError if the page was not built."""
    assets: dict[str, Asset] = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            body = path.read_bytes()
            packed = (
                gzip.compress(body, 6)
                if path.suffix in _TEXTS and len(body) > 1024
                else None
            )
            kind = mimetypes.guess_type(path.name)[0] or "application/octet-stream"
            assets[path.relative_to(folder).as_posix()] = Asset(body, packed, kind)
    if "index.html" not in assets:
        raise FailedError(
            "the page is not built: run 'npm ci && npm run build' in page/"
        )
    return assets
