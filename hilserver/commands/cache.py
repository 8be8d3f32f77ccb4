"""Show or clear what hilserver keeps so that it starts quickly: compiled code, above all.

It may be cleared at any time: the next start compiles for a minute or two. The folder is
HILSERVER_CACHE_DIR, else hilserver in XDG_CACHE_HOME or ~/.cache.
"""

import argparse
import contextlib
import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

from hilserver.cache import KERNELS, configured_folder, spare_folder
from hilserver.errors import EXIT_DONE, FailedError, reason

EXAMPLE = "hilserver cache clear"
_OTHERS = ("opcua", "portable", "compiling")
_DAY_S = 86_400


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    parser.add_argument(
        "action",
        nargs="?",
        choices=["show", "clear"],
        default="show",
        help="show (the default) or clear",
    )


def run(args: argparse.Namespace) -> int:
    """Show or clear the cache; return the exit code."""
    for base in (configured_folder(), spare_folder()):
        folders = list(_folders(base))
        if args.action == "clear":
            for path in folders:
                size = sum(_sizes(path))
                try:
                    shutil.rmtree(path)
                except OSError as error:
                    raise FailedError(
                        f"{base}: {path.name} cannot be removed: {reason(error)}"
                    ) from None
                print(f"removed {path}, {_megabytes(size)}")
            if not folders and base == configured_folder():
                print(f"{base}: nothing is kept")
        elif folders or base == configured_folder():
            _show(base, folders)
    if args.action == "show":
        # What the installation brought along is no part of the cache.
        from hilserver.compiled.cache import supplied  # noqa: PLC0415 - takes a second

        sizes = list(_sizes(supplied().folder))
        if sizes:
            print(
                f"{supplied().folder}: {_megabytes(sum(sizes))}, came with this installation"
            )
            print(
                f"  {len(sizes)} files, used where the cache has nothing for this processor"
            )
    return EXIT_DONE


def _folders(base: Path) -> Iterator[Path]:
    """Yield our folders of a cache: if the wrong folder is configured, others stay."""
    with contextlib.suppress(OSError):
        for path in sorted(base.iterdir()):
            if path.is_dir() and (
                path.name.startswith(KERNELS) or path.name in _OTHERS
            ):
                yield path


def _show(base: Path, folders: list[Path]) -> None:
    from hilserver.compiled import kernel_hash  # noqa: PLC0415 - takes a second

    found = [(path, list(_sizes(path))) for path in folders]
    total = sum(sum(sizes) for _, sizes in found)
    can_write = not base.exists() or os.access(base, os.W_OK)
    print(f"{base}: {_megabytes(total)}{'' if can_write else ', cannot be written to'}")
    for path, sizes in found:
        mine = ", this version" if path.name == f"{KERNELS}{kernel_hash()}" else ""
        age = _age(time.time() - path.stat().st_mtime)
        print(
            f"  {path.name:24}  {_megabytes(sum(sizes)):>8}  {len(sizes):4} files  {age}{mine}"
        )
    if not found:
        print("  nothing is kept")


def _sizes(folder: Path) -> Iterator[int]:
    for path in folder.rglob("*"):
        with contextlib.suppress(OSError):  # another process writes and renames here
            if path.is_file():
                yield path.stat().st_size


def _megabytes(size: int) -> str:
    return f"{size * 1e-6:.1f} MB"


def _age(s: float) -> str:
    for name, length in (("day", _DAY_S), ("hour", 3600), ("minute", 60)):
        if s >= length:
            count = int(s // length)
            return f"used {count} {name}{'s' * (count > 1)} ago"
    return "used just now"
