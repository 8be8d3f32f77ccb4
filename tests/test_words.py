"""Words that we avoid: in documents, in every text of the package, in docstrings and names."""

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
    "astray": "diverged, wrong",
    "untold": "unidentified",
}
WORD = re.compile(rf"\b({'|'.join(AVOIDED)})\b", re.IGNORECASE)
PAGES = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("deploy/**/*.md")]
TEXTS = [
    path
    for kind in ("yaml", "csv", "j2")
    for house in ("hilserver", "reference")
    for path in ROOT.glob(f"{house}/**/*.{kind}")
]
MODULES = sorted(
    [
        *ROOT.glob("hilserver/**/*.py"),
        *ROOT.glob("benchmarks/*.py"),
        *ROOT.glob("reference/**/*.py"),
    ]
)


def texts(path: Path) -> Iterator[str]:
    """Give every text of a module, its docstrings, and the words of the names that it makes."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value
        elif isinstance(node, ast.arg):
            yield node.arg.replace("_", " ")
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name.replace("_", " ")
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id.replace("_", " ")


def found(text: str) -> list[str]:
    return [f"{word}: write {AVOIDED[word.lower()]}" for word in WORD.findall(text)]


def test_documents_avoid_them() -> None:
    hints = {path: found(path.read_text(encoding="utf-8")) for path in [*PAGES, *TEXTS]}
    assert not {str(path): said for path, said in hints.items() if said}


def test_modules_avoid_them() -> None:
    hints = {path: [h for text in texts(path) for h in found(text)] for path in MODULES}
    assert not {str(path): said for path, said in hints.items() if said}


def test_the_search_finds_them() -> None:
    assert found("Its end is told.") == ["told: write reported, said"]


def test_names_and_docstrings_are_read(tmp_path: Path) -> None:
    module = tmp_path / "module.py"
    module.write_text(
        'def who_is_told(lonely: str) -> None:\n    """It went astray."""\n'
    )
    assert len([hint for text in texts(module) for hint in found(text)]) == 3
