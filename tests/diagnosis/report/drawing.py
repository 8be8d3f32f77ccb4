"""What a reader of a drawn SVG sees: marks, where they are, their colours, the words around."""

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from importlib.resources import files

STYLE = (
    files("hilserver.diagnosis.report").joinpath("plot.css").read_text(encoding="utf-8")
)
RULE = re.compile(r"svg ((?:\.[\w.]+(?:, svg )?)+) \{([^}]*)\}")
DECLARATION = re.compile(r"([\w-]+): ([^;]+);")
MOVE = re.compile(r"M(-?[\d.]+) (-?[\d.]+)")
POINT = re.compile(r"[ML](-?[\d.]+) (-?[\d.]+)")


def _rules():
    for selectors, body in RULE.findall(STYLE):
        for selector in selectors.split(", svg "):
            yield set(selector.strip(".").split(".")), dict(DECLARATION.findall(body))


RULES = list(_rules())


@dataclass(frozen=True)
class Mark:
    """One element with its classes."""

    element: ElementTree.Element
    classes: frozenset

    @property
    def style(self):
        """All declarations that hold for it: more classes win, then the later rule."""
        held = [
            (len(of), i, own) for i, (of, own) in enumerate(RULES) if of <= self.classes
        ]
        merged = {}
        for _, _, own in sorted(held, key=lambda one: one[:2]):
            merged |= own
        return merged

    def colour(self, what):
        """The name of the colour of its `stroke` or `fill`; None where the style has none."""
        value = self.style.get(what)
        if value == "var(--of)":
            value = self.style.get("--of")
        return value and value.removeprefix("var(--").removesuffix(")")

    @property
    def title(self):
        return self.element.findtext("title", "")

    @property
    def pieces(self):
        """In how many pieces a line is drawn."""
        return len(MOVE.findall(self.element.get("d")))

    @property
    def points(self):
        return [
            (float(x), float(y)) for x, y in POINT.findall(self.element.get("d", ""))
        ]

    @property
    def at(self):
        return float(self.element.get("cx")), float(self.element.get("cy"))


class Drawing:
    """A drawn SVG element."""

    def __init__(self, svg):
        self.root = ElementTree.fromstring(str(svg))

    @property
    def marks(self):
        """Everything that has a class, in the order in which it is painted."""
        found = (e for e in self.root.iter() if e.get("class"))
        return [Mark(e, frozenset(e.get("class").split())) for e in found]

    def of(self, *classes):
        """The marks that have all these classes."""
        return [mark for mark in self.marks if mark.classes >= set(classes)]

    def texts(self, kind):
        return [mark.element.text for mark in self.of(kind)]
