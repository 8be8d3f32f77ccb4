"""What this process, or another one, holds: sockets, files, memory."""

import os
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Holdings:
    sockets: int
    files: int
    memory_kib: int

    @classmethod
    def of(cls, pid: int | None = None) -> "Holdings":
        folder = Path("/proc") / str(pid or os.getpid())
        links = []
        for entry in (folder / "fd").iterdir():
            try:
                links.append(str(entry.readlink()))
            except FileNotFoundError:
                continue  # the descriptor of this very listing
        memory = next(
            int(line.split()[1])
            for line in (folder / "status").read_text().splitlines()
            if line.startswith("VmRSS:")
        )
        sockets = sum(link.startswith("socket:") for link in links)
        return cls(sockets, len(links) - sockets, memory)
