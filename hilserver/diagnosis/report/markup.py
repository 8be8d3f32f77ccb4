"""Pieces of HTML; every text from outside is escaped here."""

from collections.abc import Iterable, Sequence
from html import escape


def paragraph(text: str, role: str = "") -> str:
    """Return a paragraph of plain text."""
    return f"<p{_class(role)}>{escape(text)}</p>"


def figure(svg: str, title: str, caption: str, *, role: str = "") -> str:
    """Return a drawing with its title above and a sentence below."""
    return (
        f"<figure{_class(role)}><h3>{escape(title)}</h3>"
        f'<div class="drawing">{svg}</div><figcaption>{escape(caption)}</figcaption></figure>'
    )


def grid(items: Iterable[str]) -> str:
    """Return figures beside each other, as many as fit."""
    return f'<div class="grid-of">{"".join(items)}</div>'


def table(
    head: Sequence[str], rows: Iterable[Sequence[str]], *, numbers: Iterable[int] = ()
) -> str:
    """Return a table; cells are HTML, heads are text, columns in `numbers` stand to the right."""
    right = set(numbers)
    cells = "".join(
        f'<th scope="col"{_class("n" if i in right else "")}>{escape(text)}</th>'
        for i, text in enumerate(head)
    )
    body = "".join(
        "<tr>"
        + "".join(
            f"<td{_class('n' if i in right else '')}>{cell}</td>" for i, cell in enumerate(row)
        )
        + "</tr>"
        for row in rows
    )
    return (
        f'<div class="table"><table><thead><tr>{cells}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def bar(share: float, role: str = "") -> str:
    """Return a bar for a table cell, `share` of its full length."""
    width = 100 * min(max(share, 0.0), 1.0)
    return f'<span class="bar {role}"><i style="width:{width:.1f}%"></i></span>'


def code(text: str) -> str:
    """Return a name of the program, such as a cause or a signal."""
    return f"<code>{escape(text)}</code>"


def legend(entries: Iterable[tuple[str, str]]) -> str:
    """Return a legend from roles and words."""
    items = "".join(
        f'<li><svg viewBox="0 0 28 8" aria-hidden="true"><path class="line {role}" d="M1 4H27"/>'
        f"</svg>{escape(text)}</li>"
        for role, text in entries
    )
    return f'<ul class="legend">{items}</ul>'


def section(name: str, title: str, intro: str, content: str) -> str:
    """Return a section, or nothing when it has no content."""
    if not content:
        return ""
    lead = paragraph(intro, "intro") if intro else ""
    return f'<section id="{name}"><h2>{escape(title)}</h2>{lead}{content}</section>'


def _class(role: str) -> str:
    return f' class="{role}"' if role else ""
