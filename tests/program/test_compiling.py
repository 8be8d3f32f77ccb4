"""Children compile what is not in the cache, once; the rest of the program finds it there."""

import json
import os
import subprocess

from hilserver.program.children import python

PROGRAM = """
import json, sys
from hilserver.program import compiling

def main():
    from hilserver.compiled.histogram import bucket_index
    assert bucket_index(5) == 0

if len(sys.argv) > 2:
    compiling.as_child(main, int(sys.argv[2]))
else:
    of_child, own = [], []
    child = [sys.executable, *([__file__, 'child'] if sys.argv[1] == 'works' else ['absent.py'])]
    asked = lambda: [child, child]
    with compiling.telling(own.append), compiling.in_children(asked, of_child.extend):
        main()
    print(json.dumps([of_child, own]))
"""


def compiled(folder, child="works"):
    """Return what the children have compiled, and what the program itself."""
    program = folder / "program.py"
    program.write_text(PROGRAM)
    cold = os.environ | {"HILSERVER_CACHE_DIR": str(folder / "cache")}
    done = subprocess.run(
        python(str(program), child),
        capture_output=True,
        text=True,
        env=cold,
        check=True,
    )
    # numba's own parts of it, such as `impl`, are not kept by themselves.
    return [
        [name for name in names if name != "impl"] for names in json.loads(done.stdout)
    ]


def test_two_children_compile_once_what_is_not_in_the_cache(tmp_path):
    assert compiled(tmp_path) == [["bucket_index"], []]
    assert compiled(tmp_path) == [[], []]


def test_where_the_children_fail_the_program_compiles_itself(tmp_path):
    assert compiled(tmp_path, "fails") == [[], ["bucket_index"]]
