"""The process image as structures in C and C#, from the signal table."""

import re
from collections.abc import Callable, Iterable
from pathlib import Path

from hilserver.image.layout import VERSION
from hilserver.image.shared_file import path_of
from hilserver.io.shared_memory.inputs import (
    HEAD_END,
    inputs_of,
    layout_number,
    name_of,
)
from hilserver.signals import Signal, SignalTable


def to_c(table: SignalTable, image: str) -> str:
    """Return the header file for C programs; `image`: name of the process image."""
    return _filled(
        "image.h",
        table,
        image,
        VALUES=_lines(table.scalars, _c_member),
        STATUS=_lines(table.scalars, lambda signal: f"    int64_t {_word(signal)};"),
        WRITTEN=_lines(inputs_of(table), _c_member),
    )


def to_csharp(table: SignalTable, image: str) -> str:
    """Return the source file for .NET programs; `image`: name of the process image."""
    written = inputs_of(table)
    return _filled(
        "image.cs",
        table,
        image,
        VALUES=_lines(table.scalars, _csharp_member),
        STATUS=_lines(
            table.scalars, lambda signal: f"        public long {_word(signal)};"
        ),
        WRITTEN=_lines(written, _csharp_member),
        NOTHING=_lines(
            written, lambda signal: f"                {_word(signal)} = double.NaN,"
        ),
    )


def _filled(template: str, table: SignalTable, image: str, **parts: str) -> str:
    numbers = {
        "IMAGE": path_of(image),
        "INPUTS": path_of(name_of(image)),
        "LAYOUT": layout_number(table),
        "VERSION": VERSION,
        "SLOTS": table.n_slots,
        "N_WRITTEN": len(inputs_of(table)),
        "HEAD_END": HEAD_END.decode().replace('"', r"\""),
    }
    text = Path(__file__).with_name(template).read_text(encoding="utf-8")
    for name, value in (numbers | parts).items():
        text = text.replace(f"@{name}@", str(value))
    return text


def _lines(signals: Iterable[Signal], line: Callable[[Signal], str]) -> str:
    return "\n".join(map(line, signals))


def _c_member(signal: Signal) -> str:
    return f"    double {_word(signal)};  /* {_about(signal)} */"


def _csharp_member(signal: Signal) -> str:
    return f"        public double {_word(signal)};  // {_about(signal)}"


def _about(signal: Signal) -> str:
    return f"{signal.direction.value}, {signal.unit}"


def _word(signal: Signal) -> str:
    return re.sub(r"\W", "_", signal.name)
