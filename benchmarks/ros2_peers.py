"""Two programs with foreign DDS libraries from Debian: Fast DDS in C++, Cyclone DDS in C.

Both are configured as by ROS 2, read and write any topic as CDR, and print the latency of each
sample. Bench and tests build them.
"""

import shutil
import subprocess
from collections.abc import Iterable, Sequence
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, Final

from hilserver.errors import FailedError
from hilserver.ros.flavours import FLAVOURS
from hilserver.ros.types import Types, known_types

Endpoint = tuple[str, str, str, str]
"""``r`` or ``w``, DDS topic, type in ROS's words, ``reliable`` or ``best_effort``."""
NEEDED: Final = {
    "g++": "g++ libfastrtps-dev",
    "cc": "gcc",
    "idlc": "cyclonedds-tools cyclonedds-dev",
}
BASE: Final = {
    "bool": "boolean",
    "byte": "octet",
    "char": "uint8",
    "float32": "float",
    "float64": "double",
}
IDENTITY: Final = "unsigned long long guid; long long sequence_number;"
"""Fields that rmw_cyclonedds puts before request and response."""


def dds_name(type_name: str) -> str:
    """``std_msgs/msg/String`` as rmw registers it."""
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def published() -> Iterable[tuple[str, str, str]]:
    """Yield DDS topic, type and reliability of what a daemon of `iotbot_shield` can write."""
    flavour = FLAVOURS["iotbot_shield"]
    for topic in (*flavour.published, *flavour.extras.values()):
        quality = "reliable" if topic.qos.reliable else "best_effort"
        yield f"rt/{topic.topic.lstrip('/')}", topic.type, quality


def arguments(domain: int, endpoints: Iterable[Endpoint]) -> list[str]:
    """Return the arguments of either program."""
    words = [str(domain)]
    for mode, topic, type_name, quality in endpoints:
        words += [mode, topic, dds_name(type_name), quality]
    return words


def build_fast_dds(folder: Path) -> Path:
    """Compile the Fast DDS peer, which takes some seconds.

    Raises
    ------
    FailedError
        If a compiler or the library is missing.
    """
    program = folder / "ros2_fast_dds"
    with as_file(files("benchmarks") / "ros2_fast_dds.cpp") as source:
        libraries = ("-lfastrtps", "-lfastcdr", "-lpthread")
        _run("g++", "-O0", "-std=c++17", str(source), "-o", str(program), *libraries)
    return program


def build_cyclone(folder: Path, type_names: Iterable[str]) -> Path:
    """Compile the Cyclone DDS peer with some types.

    Raises
    ------
    FailedError
        If a compiler or the library is missing.
    """
    names = sorted(set(type_names))
    (folder / "types.idl").write_text(idl(known_types(), names), encoding="ascii")
    rows = (
        f'{{"{dds_name(n)}", &{dds_name(n).replace("::", "_")}_desc}},\n' for n in names
    )
    (folder / "table.h").write_text("".join(rows), encoding="ascii")
    # like rmw_cyclonedds, it announces no type
    _run("idlc", "-t", "types.idl", folder=folder)
    program = folder / "ros2_cyclone"
    with as_file(files("benchmarks") / "ros2_cyclone.c") as source:
        made = (
            "-O0",
            "-I.",
            str(source),
            "types.c",
            "-o",
            str(program),
            "-lddsc",
            "-lpthread",
        )
        _run("cc", *made, folder=folder)
    return program


def _run(tool: str, *words: str, folder: Path | None = None) -> None:
    path = shutil.which(tool)
    if path is None:
        raise FailedError(f"this needs {tool} (Debian: apt-get install {NEEDED[tool]})")
    done = subprocess.run(  # noqa: S603
        [path, *words], cwd=folder, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise FailedError(
            f"{tool} failed (Debian: apt-get install {NEEDED[tool]}): {done.stderr}"
        )


def idl(types: Types, names: Sequence[str]) -> str:
    """Return the definitions of types, nested ones included, in OMG's IDL 4.2."""
    from rosbags.interfaces import Nodetype  # noqa: PLC0415 -- slow to import

    written: dict[str, str] = {}

    def word(kind: Any, rest: Any) -> tuple[str, str]:
        """Return the type, and the text that follows the member's name."""
        if kind == Nodetype.NAME:
            define(rest)
            return dds_name(rest), ""
        if kind == Nodetype.BASE:
            base, limit = rest
            return (f"string<{limit}>" if limit else BASE.get(base, base)), ""
        inner, count = rest
        member, _ = word(*inner)
        if kind == Nodetype.ARRAY:
            return member, f"[{count}]"
        return f"sequence<{member}, {count}>" if count else f"sequence<{member}>", ""

    def define(name: str) -> None:
        if name in written:
            return
        lines = [IDENTITY] if "/srv/" in name else []
        for field, (kind, rest) in types.fields(name):
            member, behind = word(kind, rest)
            lines.append(f"{member} {field}{behind};")
        package, kind, short = name.split("/")
        body = " ".join(lines) or "uint8 structure_needs_at_least_one_member;"
        written[name] = (
            f"module {package} {{ module {kind} {{ module dds_ {{\n"
            f"@final struct {short}_ {{ {body} }};\n}}; }}; }};\n"
        )

    for name in names:
        define(name)
    return "".join(written.values())
