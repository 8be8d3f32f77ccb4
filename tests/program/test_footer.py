"""What a terminal shows when a footer and log lines share it."""

import io
import re

from hilserver.program.writer import Footer


def on_screen(text):
    """Return the lines a terminal shows that knows carriage return and 'erase to the end'."""
    lines, column = [""], 0
    for part in re.split(r"(\r|\n|\x1b\[K)", text):
        if part == "\r":
            column = 0
        elif part == "\n":
            lines.append("")
            column = 0
        elif part == "\x1b[K":
            lines[-1] = lines[-1][:column]
        else:
            lines[-1] = lines[-1][:column] + part + lines[-1][column + len(part) :]
            column += len(part)
    return lines


def test_the_footer_stays_below_what_is_written():
    terminal = io.StringIO()
    footer = Footer(terminal)
    footer.write("before\n")
    footer.show("a long line of status")
    footer.write("first\n")
    footer.write("second\n")
    footer.show("short")
    assert on_screen(terminal.getvalue()) == ["before", "first", "second", "short"]
    footer.show("")
    assert on_screen(terminal.getvalue()) == ["before", "first", "second", ""]


def test_what_does_not_fit_is_left_out(monkeypatch):
    monkeypatch.setenv("COLUMNS", "20")
    terminal = io.StringIO()
    Footer(terminal).show("x" * 200)
    assert on_screen(terminal.getvalue()) == ["x" * 19]
