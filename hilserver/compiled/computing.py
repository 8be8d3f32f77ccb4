"""What computes in a Python source: its text without comments, docstrings and blank lines.

A scan of our own, because the output of `ast` and `tokenize` differs between versions of Python,
and both would take a third of a second at every start.
"""

import re
from typing import Final

_LONG: Final = rb'"""(?:\\.|[^\\])*?"""|' + rb"'''(?:\\.|[^\\])*?'''"
_SHORT: Final = rb'"(?:\\.|[^"\\\n])*"|' + rb"'(?:\\.|[^'\\\n])*'"
_PIECE: Final = re.compile(
    rb"(?P<alone>(?:\A|(?<!\\)\n)[ \t]*[A-Za-z]{0,2}(?:%b|%b)(?=[ \t\r]*(?:\#|\n|\Z)))"
    rb"|(?P<string>%b|%b)"
    rb"|(?P<nothing>\n?[ \t]*\#[^\n]*|\n[ \t\r]*(?=\n|\Z))"
    rb"|(?P<opening>[(\[{])"
    rb"|(?P<closing>[)\]}])" % (_LONG, _SHORT, _LONG, _SHORT),
    re.DOTALL,
)


def computing(source: bytes) -> bytes:
    """Return the source without what changes no result.

    A string that is a whole line is a docstring, except within brackets, where it belongs to an
    expression.
    """
    depth = 0

    def kept(piece: re.Match[bytes]) -> bytes:
        nonlocal depth
        kind = piece.lastgroup
        depth += (kind == "opening") - (kind == "closing")
        is_docstring = kind == "alone" and depth == 0
        return b"" if is_docstring or kind == "nothing" else piece[0]

    return _PIECE.sub(kept, source)
