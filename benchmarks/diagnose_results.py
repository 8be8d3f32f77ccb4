"""Results of a campaign: lines of JSON in a file that survives an interruption.

Every line has the hash of the sources that made it: results of another engine or injector stay in
the file but are not counted.
"""

import hashlib
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import hilserver_injector

import hilserver
from benchmarks.diagnose_table import Record

ROOMS: Final = ("diagnosis", "measured", "plant", "scenarios")
"""Rooms on which a finding or score depends, besides the campaign's own worker and scoring."""
OWN: Final = ("diagnose_scoring", "diagnose_worker")
DIGITS: Final = 12


def sources(own: Sequence[str] = OWN, more: Sequence[str] = ()) -> str:
    """Return the hash of the sources of engine, injector and scoring.

    Parameters
    ----------
    own : sequence of str
        Modules of the campaign itself.
    more : sequence of str
        Further rooms of the package, besides those of the engine.
    """
    package = Path(hilserver.__file__).parent
    folders = [package / r for r in (*ROOMS, *more)] + [
        Path(hilserver_injector.__file__).parent
    ]
    files = [file for folder in folders for file in folder.rglob("*.py")]
    files += [Path(__file__).with_name(f"{part}.py") for part in own]
    total = hashlib.sha256()
    for file in sorted(files, key=lambda file: file.parts[-3:]):
        total.update("/".join(file.parts[-3:]).encode())
        total.update(hashlib.sha256(file.read_bytes()).digest())
    return total.hexdigest()[:DIGITS]


class Results:
    """The results in a file that the current sources made in one setting.

    Parameters
    ----------
    setting : str
        How the logs were changed: another length or noise is another setting.
    of : str, optional
        Hash of the sources; default: those of the campaign of the diagnosis.

    Attributes
    ----------
    records : dict of str to Record
        By the key of their case.
    others : int
        Lines of the file that are not counted.
    """

    def __init__(self, file: Path, setting: str = "", of: str | None = None) -> None:
        self.file, self.stamp = file, {"sources": of or sources(), "setting": setting}
        self.records: dict[str, Record] = {}
        self.others = 0
        for record in _lines(file):
            if {key: record.get(key) for key in self.stamp} == self.stamp:
                self.records[record["key"]] = record
            else:
                self.others += 1

    def add(self, record: Record) -> None:
        """Append a result; a line that an interruption cut short is closed first."""
        record = record | self.stamp
        self.file.parent.mkdir(parents=True, exist_ok=True)
        with self.file.open("a+b") as file:
            if file.tell() and _last(self.file) != b"\n":
                file.write(b"\n")
            file.write(json.dumps(record).encode() + b"\n")
        self.records[record["key"]] = record


def _last(file: Path) -> bytes:
    with file.open("rb") as opened:
        opened.seek(-1, 2)
        return opened.read()


def _lines(file: Path) -> Iterator[Record]:
    if not file.exists():
        return
    for line in file.read_text(encoding="utf-8").splitlines():
        try:
            yield json.loads(line)
        except ValueError:
            continue  # cut short by an interruption
