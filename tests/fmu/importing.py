"""Runs a robot's FMU in the importer in C of `importer.c`."""

import re
import subprocess
import zipfile
from pathlib import Path

import numpy as np
from fmpy import read_model_description

from hilserver.fmu.variables import N_Y

IMPORTER = Path(__file__).with_name("importer.c")


def compiled(folder, compiler="gcc"):
    """Build the importer in a folder."""
    program = folder / "importer.exe"
    subprocess.run([compiler, "-w", "-O2", "-o", program, IMPORTER], check=True)
    return program


def unpacked(folder, fmu, platform="x86_64-linux"):
    """Unpack the shared library for a platform into a folder."""
    with zipfile.ZipFile(fmu) as packed:
        (name,) = (
            n for n in packed.namelist() if n.startswith(f"binaries/{platform}/robot.")
        )
        library = folder / Path(name).name
        library.write_bytes(packed.read(name))
    return library


def run(program, library, fmu, rows, n, before=()):
    """Outputs of every step, shape (n, N_Y); `rows` holds step, value reference and value."""
    folder, token = program.parent, read_model_description(str(fmu)).guid
    np.asarray(rows, dtype=float).tofile(folder / "rows")
    words = [*before, program, library, token, n, 0.001, len(rows)]
    words += [folder / "rows", folder / "outputs"]
    subprocess.run(list(map(str, words)), check=True)
    return np.fromfile(folder / "outputs").reshape(n, N_Y)


def linked_to(file):
    """The libraries that the loader takes for a program or library, without their versions."""
    said = subprocess.run(
        ["ldd", file], capture_output=True, text=True, check=True
    ).stdout
    print(said)
    return set(re.findall(r"^\s*(lib\w+)\.so", said, re.MULTILINE))
