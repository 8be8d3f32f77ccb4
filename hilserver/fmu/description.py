"""The description of an FMU: read with FMPy, and checked for what a time slice can run."""

import platform
import re
import shutil
import tempfile
import weakref
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from importlib import import_module
from importlib.util import find_spec
from math import prod
from pathlib import Path
from typing import Any, Final

from hilserver.errors import meant
from hilserver.fmu.layout import BOOLEAN, FLOAT, SIGNED, UNSIGNED
from hilserver.plant.blocks import BlockError

MISSING: Final = "needs FMPy; install it with: pip install 'hilserver[fmu]'"
MOST_BYTES: Final = 1 << 30  # size of an unpacked FMU
# size of its modelDescription.xml, read as a whole
MOST_DESCRIPTION_BYTES: Final = 1 << 26
_MACHINE: Final = {"AMD64": "x86_64", "arm64": "aarch64"}.get(
    platform.machine(), platform.machine()
)
PLATFORM: Final = f"{_MACHINE}-linux"
_FMI_2: Final = {"x86_64-linux": "linux64", "aarch64-linux": "aarch64-linux"}

_TYPES: Final[Mapping[int, Mapping[str, tuple[str, int, int]]]] = {
    2: {
        "Real": ("Real", FLOAT, 8),
        "Integer": ("Integer", SIGNED, 4),
        "Enumeration": ("Integer", SIGNED, 4),
        "Boolean": ("Boolean", BOOLEAN, 4),
        "String": ("String", -1, 0),
    },
    3: {
        **{f"Float{bits}": (f"Float{bits}", FLOAT, bits // 8) for bits in (32, 64)},
        **{f"Int{bits}": (f"Int{bits}", SIGNED, bits // 8) for bits in (8, 16, 32, 64)},
        **{
            f"UInt{bits}": (f"UInt{bits}", UNSIGNED, bits // 8)
            for bits in (8, 16, 32, 64)
        },
        "Enumeration": ("Int64", SIGNED, 8),
        "Boolean": ("Boolean", BOOLEAN, 1),
        "String": ("String", -1, 0),
    },
}
"""Function suffix, kind and size of every type, by version; text has no numeric kind."""

_UNITS: Final = {
    "": "1", "-": "1", "1": "1", "%": "%", "rad": "rad", "deg": "deg", "rad/s": "rad/s",
    "rad/s2": "rad/s²", "1/min": "rpm", "rev/min": "rpm", "rpm": "rpm", "m": "m", "mm": "mm",
    "m/s": "m/s", "m/s2": "m/s²", "km/h": "km/h", "s": "s", "ms": "ms", "Hz": "Hz", "V": "V",
    "mV": "mV", "A": "A", "mA": "mA", "Ohm": "ohm", "W": "W", "J": "J", "N": "N", "N.m": "N·m",
    "kg": "kg", "kg.m2": "kg·m²", "degC": "°C", "K": "K", "Pa": "Pa",
}  # fmt: skip
"""Units as FMUs write them -> our symbols; others go into the description of the signal."""


@dataclass(frozen=True)
class FmuVariable:
    """One variable of an FMU."""

    name: str
    reference: int
    type: str  # suffix of its functions: ``Float64``, ``Boolean``
    kind: int
    bytes: int
    shape: tuple[int, ...]  # () of a scalar
    causality: str
    variability: str
    unit: str  # our symbol, "1" if the FMU gives none or an unknown one
    low: float
    high: float
    start: float
    description: str

    @property
    def count(self) -> int:
        """Number of values."""
        return prod(self.shape)

    @property
    def scalars(self) -> list[str]:
        """Names of its values: ``y``, or ``y[1]``, ``y[2]``, in the order of the array."""
        if not self.shape:
            return [self.name]
        indices: list[tuple[int, ...]] = [()]
        for length in self.shape:
            indices = [(*before, i + 1) for before in indices for i in range(length)]
        return [f"{self.name}[{','.join(map(str, index))}]" for index in indices]


@dataclass(frozen=True)
class Fmu:
    """An FMU on disk, unpacked as long as this object exists."""

    path: Path
    folder: Path
    version: int  # 2 or 3
    identifier: str
    token: str
    library: Path  # shared library for this computer
    stores_state: bool  # whether snapshots can hold it
    variables: Mapping[str, FmuVariable]
    sha256: str

    def variable(self, name: str) -> FmuVariable:
        """Return a variable by its name.

        BlockError if there is none, or a time slice cannot handle its type.
        """
        found = self.variables.get(name)
        if found is None:
            some = ", ".join([*self.variables][:12])
            hint = meant(name, self.variables, f"known are {some}")
            raise BlockError(f"{self.path.name} has no variable '{name}'; {hint}")
        return found


def read_fmu(reference: str, base_dir: Path) -> Fmu:
    """Return the FMU of a file, unpacked.

    `reference`: as the configuration names it, relative to `base_dir`. BlockError, one sentence:
    not an FMU, no co-simulation, not for this computer, or needs something that we lack.
    """
    path = (base_dir / reference).resolve()
    try:
        return _read(path)
    except BlockError as error:
        raise BlockError(f"FMU {reference!r} {error}.") from None


def _read(path: Path) -> Fmu:
    if not path.is_file():
        raise BlockError(f"does not exist: there is no file {path}")
    if find_spec("fmpy") is None:
        raise BlockError(MISSING)
    try:
        with zipfile.ZipFile(path) as packed:
            entries = {info.filename: info.file_size for info in packed.infolist()}
        if "modelDescription.xml" not in entries:
            raise BlockError("has no modelDescription.xml; export it again")
        outside = [entry for entry in entries if ".." in entry.split("/")]
        if outside:
            raise BlockError(
                f"has a path that leaves the archive, '{outside[0]:.60}'; export it again"
            )
        if sum(entries.values()) > MOST_BYTES:
            raise BlockError(f"unpacks to more than {MOST_BYTES >> 30} GB")
        if entries["modelDescription.xml"] > MOST_DESCRIPTION_BYTES:
            most = MOST_DESCRIPTION_BYTES >> 20
            raise BlockError(f"has a modelDescription.xml of more than {most} MB")
        with path.open("rb") as file:
            said = import_module("fmpy").read_model_description(file)
    except BlockError:
        raise
    except zipfile.BadZipFile:
        raise BlockError("is not a zip file; export it again") from None
    except Exception as error:  # noqa: BLE001 - whatever FMPy's readers raise
        raise BlockError(
            f"has an invalid modelDescription.xml: {_one_line(error)}"
        ) from None
    version = int(said.fmiVersion.partition(".")[0])
    _check(said, version)
    identifier = said.coSimulation.modelIdentifier
    member = _library(identifier, version, set(entries))
    folder = _unpacked(path)
    can = said.coSimulation
    by_name = {v.name: v for v in _variables(said, version)}
    fmu = Fmu(
        path=path,
        folder=folder,
        version=version,
        identifier=identifier,
        token=said.guid,
        library=folder / member,
        stores_state=can.canGetAndSetFMUstate and can.canSerializeFMUstate,
        variables=by_name,
        sha256=sha256(path.read_bytes()).hexdigest(),
    )
    weakref.finalize(fmu, shutil.rmtree, folder, ignore_errors=True)
    return fmu


def _one_line(error: Exception) -> str:
    problems = getattr(error, "problems", None)
    text = str(problems[0] if problems else error)
    return " ".join(text.split())[:200].rstrip(".")


def _check(said: Any, version: int) -> None:
    if version not in _TYPES:
        raise BlockError(f"is of FMI {said.fmiVersion}; FMI 2.0 and 3.0 run here")
    if any(v.type == "Clock" for v in said.modelVariables):
        raise BlockError(
            "has clocks, which need event mode; a time slice has no event mode"
        )
    if said.coSimulation is None:
        raise BlockError(
            "offers no co-simulation; export it with its solver (co-simulation)"
        )
    if said.coSimulation.needsExecutionTool:
        raise BlockError(
            "runs only with the tool that made it; export it as stand-alone"
        )


def _library(identifier: str, version: int, entries: set[str]) -> str:
    """Return the name of the shared library for this computer."""
    name = PLATFORM if version == 3 else _FMI_2.get(PLATFORM, PLATFORM)
    wanted = f"binaries/{name}/{identifier}.so"
    if wanted not in entries:
        others = sorted(
            {n.split("/")[1] for n in entries if re.match("binaries/[^/]+/.", n)}
        )
        if name in others:
            raise BlockError(
                f"has no {wanted:.100}, which its description names; export it again"
            )
        raise BlockError(
            f"has no shared library for {name}, only for {', '.join(others) or 'none'}; export it"
            " for this computer"
        )
    return wanted


def _unpacked(path: Path) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="hilserver-fmu-"))
    try:
        import_module("fmpy").extract(str(path), str(folder))
    except Exception as error:  # noqa: BLE001 - the same
        shutil.rmtree(folder, ignore_errors=True)
        raise BlockError(f"cannot be unpacked: {_one_line(error)}") from None
    return folder


def _variables(said: Any, version: int) -> list[FmuVariable]:
    found = []
    for v in said.modelVariables:
        suffix, kind, size = _TYPES[version].get(v.type, ("", -2, 0))
        if kind < -1 or v.causality == "independent":
            continue
        unit = v.unit or (v.declaredType.unit if v.declaredType else None) or ""
        known = _UNITS.get(unit) or (unit if unit in _UNITS.values() else None)
        text = v.description or ""
        found.append(
            FmuVariable(
                name=v.name,
                reference=v.valueReference,
                type=suffix,
                kind=kind,
                bytes=size,
                shape=tuple(v.shape or ()),
                causality=v.causality,
                variability=v.variability,
                unit=known or "1",
                low=_number(v.min, -1e9),
                high=_number(v.max, 1e9),
                start=_number(v.start, 0.0),
                description=text if known else f"{text} [{unit}]".strip(),
            )
        )
    return found


def _number(text: object, otherwise: float) -> float:
    """Return a start value or limit as a number; not needed for arrays and text."""
    truth: Callable[[str], float | None] = {"true": 1.0, "false": 0.0}.get
    try:
        value = truth(str(text).lower())
        return float(str(text)) if value is None else value
    except ValueError:
        return otherwise
