"""The reference page holds the table of terms as it is."""

from pathlib import Path

from hilserver.plant.terms import TERMS

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "plant.md"


def row(term):
    null = "none" if term.null is None else f"{term.null:g}"
    reference = "" if term.reference is None else f"{term.reference:g}"
    text = term.description.replace("|", r"\|")
    cells = (f"`{term.name}`", term.block, term.unit, null, reference, text)
    return "| " + " | ".join(cells) + " |"


def test_every_term_stands_in_the_page():
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    start = lines.index("## Terms")
    table = [line for line in lines[start:] if line.startswith("| `")]
    wanted = [row(term) for term in TERMS.values()]
    assert table == wanted
