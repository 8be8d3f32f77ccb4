"""Builds a wheel with compiled code for each Python that is found: ``make wheels``.

Compiled code fits exactly the versions that it was made with, so each wheel is made in an
environment of its own, with the versions in constraints.txt.
"""

import argparse
import os
import runpy
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
pythons = runpy.run_path(str(ROOT / ".ci" / "pythons.py"))
LIMIT_S = 3600.0


def build(python: str, out: Path) -> str:
    """Build sdist and wheel for an interpreter; return what was compiled.

    Raises
    ------
    RuntimeError
        A command has failed; the message is what it printed.
    """
    uv = [sys.executable, "-m", "uv"]
    with tempfile.TemporaryDirectory(prefix="hilserver-wheel-") as folder:
        environment, objects = Path(folder, "venv"), Path(folder, "objects")
        inner = str(environment / "bin" / "python")
        versions = ["--constraint", "constraints.txt"]
        physics = ["--requirement", "pyproject.toml", "--extra", "physics"]
        _run(*uv, "venv", "--quiet", "--python", python, str(environment))
        _run(*uv, "pip", "install", "--quiet", "--python", inner, *versions, *physics)
        compiled = _run(inner, "deploy/objects.py", str(objects), PYTHONPATH=str(ROOT))
        words = ["--quiet", "--python", inner, "--out-dir", str(out), "."]
        _run(*uv, "build", *words, HILSERVER_OBJECTS=str(objects))
    return compiled.removeprefix(f"{objects}: ").strip()


def _run(*command: str, **environment: str) -> str:
    done = subprocess.run(  # noqa: S603 - words of this script
        command,
        cwd=ROOT,
        env=os.environ | environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}:\n{done.stdout}")
    return done.stdout


def main() -> int:
    """Build all, as many at once as there are cores; print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "dist")
    parser.add_argument(
        "only",
        nargs="*",
        help="interpreters, such as python3.12, or their paths; default: all",
    )
    args = parser.parse_args()
    names = args.only or pythons["NAMES"]
    found = {
        name: str(Path(name).absolute()) if os.sep in name else pythons["find"](name)
        for name in names
    }
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        building = {
            name: pool.submit(build, python, args.out)
            for name, python in found.items()
            if python is not None
        }
    has_failed = not building
    for name in names:
        if name not in building:
            print(f"{name}: not on this computer, so it has no wheel")
        elif error := building[name].exception():
            has_failed = True
            print(f"{name}: failed: {error}")
        else:
            print(f"{name}: {building[name].result()}")
    return 1 if has_failed else 0


if __name__ == "__main__":
    sys.exit(main())
