"""Files and folders that a browser may name: plain names, within the configured folders."""

import contextlib
import html
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hilserver.io.page.hand import RefusedError

LOG_SUFFIXES = (".csv", ".mcap", ".parquet", ".db3")
REPORT = "report.html"
BEGUN = "finished.jsonl"
"""File of a sweep that exists from its first machine on; the report comes at its end."""
MOST_REPORTS = 200
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")
_HEAD_BYTES = 4096
_TITLE = re.compile(r"<title>(.{0,300}?)</title>", re.DOTALL)


def is_plain(name: object) -> bool:
    """Whether `name` is a plain file name: no path, nothing hidden."""
    return isinstance(name, str) and _NAME.fullmatch(name) is not None


def files_in(folder: Path, *suffixes: str) -> Iterator[dict[str, Any]]:
    """Yield name, size and time of every plain file of a folder, the newest first."""
    with contextlib.suppress(OSError):
        entries = [(path, path.stat()) for path in folder.iterdir() if path.is_file()]
        for path, status in sorted(entries, key=lambda row: -row[1].st_mtime)[:500]:
            if (not suffixes or path.suffix in suffixes) and _NAME.fullmatch(path.name):
                yield {
                    "name": path.name,
                    "bytes": status.st_size,
                    "modified_s": status.st_mtime,
                }


def file_in(folder: Path, name: object) -> Path:
    """Return a file by its plain name; RefusedError if there is none."""
    if not is_plain(name):
        raise RefusedError(f"{str(name)!r:.60} is not a plain file name")
    path = folder / str(name)
    if not path.is_file():
        raise RefusedError(f"there is no '{name}' in the folder {folder.name}")
    return path


def reports_in(folder: Path) -> Iterator[dict[str, Any]]:
    """Yield name, time and title of every report of a folder, the newest first.

    The title states the result; None if the work has not ended.
    """
    found = []
    with contextlib.suppress(OSError):
        for path in folder.iterdir():
            made = next((p for n in (REPORT, BEGUN) if (p := path / n).is_file()), None)
            if made is not None and is_plain(path.name):
                found.append((made.stat().st_mtime, made))
    for modified_s, made in sorted(found, reverse=True)[:MOST_REPORTS]:
        title = _title(made) if made.name == REPORT else None
        yield {"name": made.parent.name, "modified_s": modified_s, "title": title}


def shown_report(folder: Path, name: str) -> Path | None:
    """Return the file of a report by the plain name of its folder, if there is one."""
    path = folder / name / REPORT
    return path if is_plain(name) and path.is_file() else None


def _title(path: Path) -> str:
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES).decode(errors="replace")
    except OSError:
        return ""
    match = _TITLE.search(head)
    return html.unescape(match[1]).strip() if match else ""
