"""The compiler's code leaves the memory, and comes again when it is called."""

import re
from pathlib import Path

from numba import njit

from hilserver.program.giving_back import give_back_code

OF_COMPILER = re.compile(r"r-xp .*libllvmlite\.so\n(?:.*\n)*?Rss: +(\d+) kB")


def kilobytes():
    return int(
        OF_COMPILER.search(Path("/proc/self/smaps").read_text(encoding="utf-8"))[1]
    )


def test_the_compiler_leaves_and_comes_again():
    assert njit(lambda x: x + 1)(1) == 2
    before = kilobytes()
    give_back_code()
    assert kilobytes() < before / 4
    assert njit(lambda x: x + 2)(1) == 3
    assert kilobytes() > before / 4
