"""The hash in recordings follows what computes, not what is said about it."""

import io
import tokenize

import pytest

from hilserver.compiled.cache import hash_of, kernel_sources
from hilserver.compiled.computing import computing

SOURCE = '''"""What it is."""

LIMIT = 3
"""What the limit is for."""
TEXTS = (
    "a # is no comment here"
    """nor is this a docstring"""
)


def step(x: float) -> float:
    """Return the next x."""
    # A riddle.
    y = x + LIMIT  # solved
    return y
'''


def hash_after(old: str, new: str, folder) -> str:
    assert old in SOURCE
    file = folder / "step.py"
    file.write_text(SOURCE.replace(old, new))
    return hash_of([file])


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("A riddle", "An answer"),
        ("    # A riddle.\n", ""),
        ("  # solved", ""),
        ("Return the next x.", "Return x after this step.\n\n    In full.\n    "),
        ('    """Return the next x."""\n', ""),
        ("What it is.", "What it is not."),
        ("What the limit is for.", "It isn't (said) #."),
        ("\n\n\n", "\n\n"),
        ("y\n", "y"),
    ],
)
def test_what_is_said_about_the_code_does_not_change_its_hash(tmp_path, old, new):
    assert hash_after(old, new, tmp_path) == hash_after("", "", tmp_path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("x + LIMIT", "x - LIMIT"),
        ("LIMIT = 3", "LIMIT = 4"),
        ("# is no", "# was no"),
        ("nor is this", "nor was this"),
        ("    return y", "return y"),
        ("y = x", "# y = x"),
    ],
)
def test_whatever_computes_changes_the_hash(tmp_path, old, new):
    assert hash_after(old, new, tmp_path) != hash_after("", "", tmp_path)


@pytest.mark.parametrize("room", ["plant", "kernel", "body", "image", "observer"])
def test_what_is_left_of_our_kernels_is_all_their_code(room):
    """Compared with Python's own tokenizer."""
    sources = [path.read_bytes() for path in kernel_sources() if path.parent.name == room]
    assert sources
    for source in sources:
        assert code(computing(source)) == code(source)


def code(source: bytes) -> list[tuple[str, int]]:
    """Return the tokens that compute, with their columns."""
    found = list(tokenize.tokenize(io.BytesIO(source).readline))
    found = [token for token in found if token.type not in (tokenize.COMMENT, tokenize.NL)]
    ends = (tokenize.ENCODING, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)
    return [
        (token.string, token.start[1])
        for before, token, after in zip(found, found[1:], found[2:], strict=False)
        if token.string.strip()
        and not (token.type == tokenize.STRING and before.type in ends and after.type in ends)
    ]
