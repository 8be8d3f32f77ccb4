"""LLVM's text for machine code: its lines by block, and the parts of a line."""

import re
from typing import Final

from hilserver.errors import FailedError

VALUE: Final = (
    r'(?:[%@]"[^"]+"|[%@][\w.$-]+|-?0x[0-9A-F]+|-?\d[\d.e+-]*'
    r"|true|false|null|undef|poison)"
)
NAME: Final = r'(?:"[^"]+"|[\w.$-]+)'
TYPE: Final = r"(?:double|ptr|void|i(?:1|8|32|64)\b|\[[^\]]*\])"
_NOISE: Final = re.compile(
    r"\b(?:noundef|nonnull|noalias|nocapture|readonly|writeonly|immarg|zeroext|signext|returned"
    r"|captures\(\w*\)|dereferenceable(?:_or_null)?\(\d+\)|range\([^)]*\)|align \d+)(?=[ ,)])"
)
FLAGS: Final = r"(?:(?:nuw|nsw|exact|disjoint|nneg|inbounds|samesign|nusw) )*"

_SIZES: Final = {"double": 8, "ptr": 8, "i1": 1, "i8": 1, "i32": 4, "i64": 8}


def blocks(body: str) -> dict[str, list[str]]:
    """Return the lines of every block, by label."""
    blocks: dict[str, list[str]] = {}
    text = re.sub(
        r"\[\n(.*?)\n\s*\]", lambda m: f"[{m[1]}]".replace("\n", " "), body, flags=re.S
    )
    lines: list[str] = []
    for raw in text.splitlines():
        label = re.match(r'^("[^"]+"|[\w.$-]+):', raw)
        line = re.sub(
            r"(?:, ![\w.]+ ![\w.]+)+|(?: #\d+)$", "", raw.partition(" ;")[0].strip()
        )
        if label:
            lines = blocks.setdefault(label[1].strip('"'), [])
        elif line:
            if not blocks:
                lines = blocks.setdefault("entry", [])
            lines.append(re.sub(r"  +", " ", _NOISE.sub("", line)))
    return blocks


def match(pattern: str, text: str) -> tuple[str, ...]:
    """Return what the groups of a pattern match at the beginning of a line.

    FailedError if it is not such a line.
    """
    found = re.match(pattern, text)
    if found is None:
        raise FailedError(
            f"the kernels' machine code has a line that C lacks: {text[:200]}"
        )
    return found.groups()


def split(text: str) -> list[str]:
    """Split at commas outside brackets."""
    depth = 0
    pieces = [""]
    for sign in text:
        depth += (sign in "([{<") - (sign in ")]}>")
        if sign == "," and depth == 0:
            pieces.append("")
        else:
            pieces[-1] += sign
    return [piece.strip() for piece in pieces if piece.strip()]


def size_of(kind: str) -> int:
    """Return the size of a type in bytes."""
    if kind[0] == "[":
        count, _, of = kind[1:-1].partition(" x ")
        return int(count) * size_of(of)
    return _SIZES[kind]
