"""The second generator, `second.c`: compiled once a process, its logs as tables."""

import subprocess
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from hilserver_injector import Table

SOURCE = Path(__file__).with_name("second.c")
LONGEST_S = 60.0


@cache
def _folder():
    """The folder of the program, as long as this process lives."""
    made = TemporaryDirectory(prefix="second-generator-")
    warnings = ["-Wall", "-Wextra", "-Werror"]
    words = [
        "cc",
        "-std=c11",
        "-D_GNU_SOURCE",
        "-O2",
        *warnings,
        str(SOURCE),
        "-lm",
        "-o",
    ]
    subprocess.run([*words, f"{made.name}/second"], check=True)
    return made


def can_hide(causes):
    """Whether the program knows these parameters."""
    text = _source()
    return all(f'hidden("{name}"' in text for name in causes)


@cache
def _source():
    return SOURCE.read_text(encoding="utf-8")


def written(kind, duration_s, drive_seed, noise_seed, causes):
    """The text of a log: CSV as the log contract has it."""
    hidden = [f"{name}={value!r}" for name, value in causes.items()]
    words = [
        f"{_folder().name}/second",
        kind,
        str(duration_s),
        str(drive_seed),
        str(noise_seed),
    ]
    run = subprocess.run(
        [*words, *hidden], capture_output=True, text=True, check=True, timeout=LONGEST_S
    )
    return run.stdout


def make(*log):
    """A log as a table, like the first generator's."""
    head, *lines = written(*log).splitlines()
    cells = [[float(cell or "nan") for cell in line.split(",")] for line in lines]
    rows = np.array(cells)
    names = head.split(",")
    return Table(
        rows[:, 0], {name: rows[:, k].copy() for k, name in enumerate(names) if k > 0}
    )
