"""Words that we avoid, in documents and in every text of the package that a user may read."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
AVOIDED = {
    "nought": "zero",
    "mend": "remedy, fix",
    "mends": "fixes",
    "mended": "fixed, corrected",
    "told": "reported, said",
    "lonely": "single",
    "thrown": "outliers",
    "blue moon": "rarely",
    "lest": "so that ... not",
    "whosoever": "anyone who",
    "fro": "back and forth",
}
WORD = re.compile(rf"\b({'|'.join(AVOIDED)})\b", re.IGNORECASE)
PAGES = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("deploy/**/*.md")]
TEXTS = [path for kind in ("yaml", "csv", "j2") for path in ROOT.glob(f"hilserver/**/*.{kind}")]
MODULES = sorted(ROOT.glob("hilserver/**/*.py"))


def literals(path: Path) -> Iterator[str]:
    """Give every text of a module but its docstrings."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docs = {ast.get_docstring(n, clean=False) for n in ast.walk(tree) if isinstance(n, documented)}
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and node.value not in docs
        ):
            yield node.value


def found(text: str) -> list[str]:
    return [f"{word}: write {AVOIDED[word.lower()]}" for word in WORD.findall(text)]


def test_documents_avoid_them() -> None:
    hints = {path: found(path.read_text(encoding="utf-8")) for path in [*PAGES, *TEXTS]}
    assert not {str(path): said for path, said in hints.items() if said}


def test_messages_avoid_them() -> None:
    hints = {path: [h for text in literals(path) for h in found(text)] for path in MODULES}
    assert not {str(path): said for path, said in hints.items() if said}


def test_the_search_finds_them() -> None:
    assert found("Its end is told.") == ["told: write reported, said"]
