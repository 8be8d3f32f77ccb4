"""The kernels' machine code as C: every operation of LLVM's listing becomes one of C, in its order.

Both follow IEEE 754, so a compiler that contracts nothing (``-ffp-contract=off``) gives the same
bits as LLVM does. Vectors, and all else that the plant's kernels do not use, are refused.
"""

import re
import struct
from collections.abc import Iterator, Mapping
from math import inf, isinf, isnan
from typing import Final

from hilserver.errors import FailedError
from hilserver.fmu.listing import (
    FLAGS,
    NAME,
    TYPE,
    VALUE,
    blocks,
    match,
    size_of,
    split,
)

HEAD: Final = """\
/* Generated: the kernels of the robot, operation by operation. Multiplications and additions are
 * not to be contracted: -ffp-contract=off. */
#if defined __GNUC__ && !defined __clang__
#pragma GCC optimize("fp-contract=off")
#else
#pragma STDC FP_CONTRACT OFF
#endif
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define LOAD(type, name) \\
    static inline type load_##name(const char *p) { type v; memcpy(&v, p, sizeof v); return v; }
#define STORE(type, name) \\
    static inline void store_##name(char *p, type v) { memcpy(p, &v, sizeof v); }
#define BOTH(type, name) LOAD(type, name) STORE(type, name)
BOTH(double, double) BOTH(uint8_t, i8) BOTH(uint32_t, i32) BOTH(uint64_t, i64) BOTH(char *, ptr)

"""
_C: Final = {
    "void": "void", "double": "double", "ptr": "char *", "i1": "uint8_t", "i8": "uint8_t",
    "i32": "uint32_t", "i64": "uint64_t",
}  # fmt: skip
_SIGNED: Final = {"i8": "int8_t", "i32": "int32_t", "i64": "int64_t"}
_PLAIN: Final = {
    "add": "+", "sub": "-", "mul": "*", "and": "&", "or": "|", "xor": "^", "shl": "<<",
    "lshr": ">>", "udiv": "/", "urem": "%", "fadd": "+", "fsub": "-", "fmul": "*", "fdiv": "/",
}  # fmt: skip
_OF_SIGNED: Final = {"sdiv": "/", "srem": "%", "ashr": ">>"}
_FLOAT: Final = {
    "oeq": "{0} == {1}", "ogt": "{0} > {1}", "oge": "{0} >= {1}", "olt": "{0} < {1}",
    "ole": "{0} <= {1}", "one": "{0} < {1} || {0} > {1}", "ord": "{0} == {0} && {1} == {1}",
    "ueq": "!({0} < {1} || {0} > {1})", "ugt": "!({0} <= {1})", "uge": "!({0} < {1})",
    "ult": "!({0} >= {1})", "ule": "!({0} > {1})", "une": "{0} != {1}",
    "uno": "{0} != {0} || {1} != {1}",
}  # fmt: skip
_WHOLE: Final = {"eq": "==", "ne": "!=", "gt": ">", "ge": ">=", "lt": "<", "le": "<="}
_INTRINSICS: Final = {
    **{name: name for name in ("fabs", "floor", "ceil", "sqrt", "sin", "cos", "exp", "log", "pow")},
    **{name: name for name in ("trunc", "rint", "round", "copysign", "fma", "memcpy", "memset")},
    "minnum": "fmin", "maxnum": "fmax", "memmove": "memmove",
}  # fmt: skip
_IGNORED: Final = ("llvm.assume", "llvm.lifetime", "llvm.experimental.noalias")
_LIBM: Final = (
    "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "exp", "expm1", "log", "log1p", "pow",
    "fmod", "hypot", "floor", "ceil", "sqrt",
)  # fmt: skip


def translate(listing: str, entry: str, name: str) -> str:
    """Return C source for a function in an LLVM listing and for all functions that it calls.

    FailedError if there is an operation that no kernel of the plant has used so far.

    Parameters
    ----------
    listing : str
        LLVM's text of a module.
    entry : str
        The function, as the listing names it.
    name : str
        Its name in C.
    """
    listed = re.findall(
        r"^define ([^\n]*)\{\n(.*?)^\}", listing, re.DOTALL | re.MULTILINE
    )
    functions = {
        match(rf".*?@({NAME})\(", head)[0]: (head, body) for head, body in listed
    }
    arrays = dict(
        re.findall(rf'^(@{NAME}) = .*?constant \[\d+ x i8\] c"(.*?)"', listing, re.M)
    )
    wanted = [entry]
    names = {entry: name}
    for function in wanted:
        for callee in re.findall(rf"call [^\n]*?@({NAME})\(", functions[function][1]):
            if callee in functions and callee not in names:
                names[callee] = _readable(callee, len(wanted))
                wanted.append(callee)
    made = [_Function(*functions[function], names) for function in wanted]
    texts = [function.text() for function in made]
    used = dict.fromkeys(name for function in made for name in function.arrays)
    constants = [_words(name, arrays[name]) for name in used]
    declared = "".join(f"{function.head};\n" for function in made)
    return "\n".join([HEAD + declared, *constants, *texts])


def c_number(value: float) -> str:
    """Return a number as a C literal, exact to the bit."""
    if isnan(value):
        return "NAN"
    if isinf(value):
        return "INFINITY" if value == inf else "-INFINITY"
    return value.hex()


class _Function:
    """One function as C; `names`: C names of the functions, by their names in the listing."""

    def __init__(self, head: str, body: str, names: Mapping[str, str]) -> None:
        kind, name, arguments = match(
            rf"(?:.* )?({TYPE}) @({NAME})\((.*?)\)[^)]*$", head
        )
        self._functions = names
        self._names: dict[str, str] = {}
        self._declared: list[str] = []
        self._labels: dict[str, str] = {}
        self.arrays: list[str] = []  # constants that it reads
        given = [match(rf"({TYPE}) .*?({VALUE})$", a) for a in split(arguments)]
        inside = [f"{_C[kind_of]} {self._value(value)}" for kind_of, value in given]
        self.head = f"static {_C[kind]} {names[name]}({', '.join(inside)})"
        self._blocks = blocks(body)
        self._phis = {
            label: list(self._phis_of(lines)) for label, lines in self._blocks.items()
        }

    def text(self) -> str:
        """Return the definition."""
        lines = []
        for label, block in self._blocks.items():
            lines.append(f"{self._label(label)}:;")
            for line in block:
                lines += [f"    {text}" for text in self._line(line, label)]
        head = [f"    {text};" for text in self._declared]
        return "\n".join([f"{self.head} {{", *head, *lines, "}\n"])

    # --- names and values -------------------------------------------------------------------------

    def _value(self, text: str, kind: str = "double") -> str:
        """Return an operand."""
        if text[0] == "%":
            plain = "v" + re.sub(r"\W+", "_", text[1:])
            plain += "_" * (text not in self._names and plain in self._names.values())
            return self._names.setdefault(text, plain)
        if text in ("null", "undef", "poison", "false"):
            return "NULL" if kind == "ptr" else "0"
        if text == "true":
            return "1"
        if text[0] == "@":
            self.arrays.append(text)
            return f"(char *){_c_name(text)}"
        if kind == "double":
            if "x" in text:
                raw = struct.unpack(">d", bytes.fromhex(text[2:]))[0]
            else:
                raw = float(text)
            return c_number(raw)
        return f"(({_C[kind]}){text}{'LL' if kind == 'i64' else ''})"

    def _label(self, text: str) -> str:
        return self._labels.setdefault(text.strip('"'), f"L{len(self._labels)}")

    def _new(self, name: str, kind: str) -> str:
        found = self._value(name)
        self._declared.append(f"{_C[kind]} {found}")
        return found

    # --- statements -------------------------------------------------------------------------------

    def _line(self, line: str, label: str) -> Iterator[str]:
        name, _, rest = (
            line.partition(" = ") if line.startswith("%") else ("", "", line)
        )
        words = rest.split(" ")
        operation = words[1] if words[0] in ("tail", "musttail", "notail") else words[0]
        if operation == "phi":
            return
        if operation in ("br", "switch", "ret", "unreachable"):
            yield from self._end(rest, label)
        elif operation == "store":
            kind, value, place = match(
                rf"store ({TYPE}) ({VALUE}), ptr ({VALUE})", rest
            )
            yield f"store_{kind}({self._value(place, 'ptr')}, {self._value(value, kind)});"
        elif operation == "call":
            yield from self._call(name, rest)
        elif operation == "alloca":
            (kind,) = match(rf"alloca ({TYPE})", rest)
            room = f"{self._new(name, 'ptr')}_room"
            self._declared.append(f"uint64_t {room}[{-(-size_of(kind) // 8)}]")
            yield f"{self._value(name)} = (char *){room};"
        else:
            kind, text = self._expression(operation, rest)
            yield f"{self._new(name, kind)} = {text};"

    def _expression(self, operation: str, rest: str) -> tuple[str, str]:
        """Return type and text of an operation that has a value."""
        v = self._value
        if operation == "load":
            kind, place = match(rf"load ({TYPE}), ptr ({VALUE})", rest)
            return kind, f"load_{kind}({v(place, 'ptr')})"
        if operation == "getelementptr":
            return "ptr", self._place(rest)
        if operation == "select":
            c, kind, a, b = match(
                rf"select i1 ({VALUE}), ({TYPE}) ({VALUE}), {TYPE} ({VALUE})", rest
            )
            return kind, f"{v(c, 'i1')} ? {v(a, kind)} : {v(b, kind)}"
        if operation in ("fcmp", "icmp"):
            how, kind, a, b = match(
                rf"\wcmp {FLAGS}(\w+) ({TYPE}) ({VALUE}), ({VALUE})", rest
            )
            if operation == "fcmp":
                return "i1", _FLOAT[how].format(v(a), v(b))
            cast = f"({_SIGNED[kind]})" if how[0] == "s" else ""
            sign = _WHOLE[how[-2:]]
            return "i1", f"{cast}{v(a, kind)} {sign} {cast}{v(b, kind)}"
        if operation in ("fneg", "freeze"):
            kind, a = match(rf"\w+ ({TYPE}) ({VALUE})", rest)
            return kind, f"{'-' if operation == 'fneg' else ''}{v(a, kind)}"
        if operation in _PLAIN or operation in _OF_SIGNED or operation == "frem":
            return self._computed(operation, rest)
        return self._cast(operation, rest)

    def _computed(self, operation: str, rest: str) -> tuple[str, str]:
        kind, *both = match(rf"\w+ {FLAGS}({TYPE}) ({VALUE}), ({VALUE})", rest)
        a, b = (self._value(value, kind) for value in both)
        if operation == "frem":
            return kind, f"fmod({a}, {b})"
        if operation in _PLAIN:
            text = f"{a} {_PLAIN[operation]} {b}"
            return kind, f"({text}) & 1" if kind == "i1" else text
        cast = f"({_SIGNED[kind]})"
        return kind, f"{cast}{a} {_OF_SIGNED[operation]} {cast}{b}"

    def _cast(self, operation: str, rest: str) -> tuple[str, str]:
        source, a, kind = match(rf"\w+ {FLAGS}({TYPE}) ({VALUE}) to ({TYPE})", rest)
        value = self._value(a, source)
        if operation == "bitcast" and source == kind:
            return kind, value
        if operation == "bitcast" and {source, kind} == {"double", "i64"}:
            return kind, f"load_{kind}((const char *)&(const {_C[source]}){{{value}}})"
        if operation == "sext" and source == "i1":
            return kind, f"{value} ? ({_C[kind]})-1 : 0"
        casts = {
            "zext": "", "uitofp": "", "sext": f"({_SIGNED.get(source)})",
            "sitofp": f"({_SIGNED.get(source)})", "fptosi": f"({_SIGNED.get(kind)})",
            "trunc": f"({_C[kind]})",
        }  # fmt: skip
        if operation not in casts:
            raise FailedError(
                f"the kernels' machine code has an operation that C lacks: {rest}"
            )
        text = casts[operation] + value
        return kind, f"({text}) & 1" if kind == "i1" else text

    def _place(self, rest: str) -> str:
        kind, base, more = match(
            rf"getelementptr {FLAGS}({TYPE}), ptr ({VALUE}), (.*)", rest
        )
        steps = []
        for index in split(more):
            whole, value = match(rf"(i\d+) ({VALUE})", index)
            steps.append(f"(int64_t){self._signed(value, whole)} * {size_of(kind)}")
            if kind[0] == "[":
                kind = kind[1:-1].partition(" x ")[2]
        return f"{self._value(base, 'ptr')} + ({' + '.join(steps)})"

    def _signed(self, value: str, kind: str) -> str:
        return f"({_SIGNED[kind]}){self._value(value, kind)}"

    def _call(self, name: str, rest: str) -> Iterator[str]:
        kind, callee, given = match(rf".*?call .*?({TYPE}) @({NAME})\((.*)\)", rest)
        if callee.startswith(_IGNORED):
            return
        arguments = []
        for argument in split(given):
            kind_of, value = match(rf"({TYPE}) +({VALUE})", argument)
            arguments.append((kind_of, self._value(value, kind_of)))
        target = f"{self._new(name, kind)} = " if name else ""
        yield f"{target}{self._called(callee, kind, arguments)};"

    def _called(self, callee: str, kind: str, arguments: list[tuple[str, str]]) -> str:
        values = [value for _, value in arguments]
        if callee in self._functions or callee in _LIBM:
            return f"{self._functions.get(callee, callee)}({', '.join(values)})"
        name = callee.split(".")[1] if callee.startswith("llvm.") else ""
        if name in _INTRINSICS:
            least = 3 if name.startswith("mem") else len(values)
            return f"{_INTRINSICS[name]}({', '.join(values[:least])})"
        if name in ("smax", "smin", "umax", "umin"):
            cast = f"({_SIGNED[kind]})" if name[0] == "s" else ""
            a, b = values
            comparison = ">" if name.endswith("ax") else "<"
            return f"{cast}{a} {comparison} {cast}{b} ? {a} : {b}"
        if name == "abs":
            return f"({_SIGNED[kind]}){values[0]} < 0 ? 0 - {values[0]} : {values[0]}"
        raise FailedError(
            f"the kernels' machine code calls a function that C lacks: {callee}"
        )

    # --- jumps ------------------------------------------------------------------------------------

    def _end(self, rest: str, label: str) -> Iterator[str]:
        if rest.startswith("ret"):
            kind, value = match(rf"ret ({TYPE})(?: ({VALUE}))?", rest)
            yield "return;" if kind == "void" else f"return {self._value(value, kind)};"
        elif rest == "unreachable":
            yield "abort();"
        elif rest.startswith("switch"):
            kind, value, default, cases = match(
                rf"switch ({TYPE}) ({VALUE}), label (%[^ ]+) \[(.*)\]", rest
            )
            yield f"switch ({self._value(value, kind)}) {{"
            for number, target in re.findall(
                rf"{TYPE} (-?\d+), label (%{NAME})", cases
            ):
                yield f"case {self._value(number, kind)}: {self._go(target, label)}"
            yield f"default: {self._go(default, label)}"
            yield "}"
        else:
            targets = re.findall(rf"label (%{NAME})", rest)
            if len(targets) == 1:
                yield self._go(targets[0], label)
                return
            (condition,) = match(rf"br i1 ({VALUE}),", rest)
            yield f"if ({self._value(condition, 'i1')}) {self._go(targets[0], label)}"
            yield f"else {self._go(targets[1], label)}"

    def _go(self, target: str, source: str) -> str:
        """Return the jump to a block; it first sets the block's phi values for this source."""
        name = target[1:].strip('"')
        taken = [(kind, phi, values[source]) for kind, phi, values in self._phis[name]]
        before = [
            f"const {_C[kind].rstrip()} n{i} = {self._value(value, kind)};"
            if kind != "ptr" else f"char *n{i} = {self._value(value, kind)};"
            for i, (kind, _, value) in enumerate(taken)
        ]  # fmt: skip
        after = [f"{self._value(phi)} = n{i};" for i, (_, phi, _) in enumerate(taken)]
        words = ["{", *before, *after, f"goto {self._label(name)}; }}"]
        return " ".join(words)

    def _phis_of(
        self, lines: list[str]
    ) -> Iterator[tuple[str, str, Mapping[str, str]]]:
        for line in lines:
            found = re.match(rf"(%\S+) = phi ({TYPE}) (.*)", line)
            if found:
                self._new(found[1], found[2])
                pairs = re.findall(rf"\[ ({VALUE}), (%{NAME}) \]", found[3])
                yield found[2], found[1], {s[1:].strip('"'): v for v, s in pairs}


def _c_name(name: str) -> str:
    return "c" + re.sub(r"\W+", "_", name)


def _readable(mangled: str, number: int) -> str:
    """Return the last part of a mangled name, with a number that makes it unique."""
    parts = []
    rest = mangled.removeprefix("_ZN")
    while (length := re.match(r"\d+", rest)) is not None:
        begin = length.end()
        n = int(length[0])
        parts.append(rest[begin : begin + n])
        rest = rest[begin + n :]
    return f"{parts[-1] if parts else 'kernel'}_{number}"


def _words(name: str, text: str) -> str:
    """Return a constant of 8-byte numbers; the listing has it as little-endian bytes."""
    raw = re.sub(
        rb"\\([0-9A-F]{2})", lambda m: bytes.fromhex(m[1].decode()), text.encode()
    )
    words = ", ".join(f"{word:#x}" for (word,) in struct.iter_unpack("<Q", raw))
    return f"static const uint64_t {_c_name(name)}[] = {{{words}}};\n"
