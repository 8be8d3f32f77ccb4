"""Run the short tests on every Python that we support, with newest and lowest dependencies.

``python .ci/pythons.py`` makes an environment for each in build/pythons, installs there and runs
tests/pythons. Where all interpreters were there and all have passed, `pythons.stamp` gets the hash
of the dependencies; ``--unchanged`` exits 0 if it has the present one.
"""

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
STAMP = ROOT / ".ci" / "pythons.stamp"
WORK = ROOT / "build" / "pythons"
NAMES = ("python3.11", "python3.12", "python3.13")
TESTS = ("pytest", "pytest-asyncio", "pytest-timeout", "hypothesis")
LIMIT_S = 1800.0


def dependencies() -> str:
    """Return the hash of what we require and of the versions that make installs."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
        "project"
    ]
    required = json.dumps([project["requires-python"], project["dependencies"]])
    constraints = (ROOT / "constraints.txt").read_text(encoding="utf-8")
    return hashlib.sha256((required + constraints).encode()).hexdigest()[:16]


def find(name: str) -> str | None:
    """Return the first interpreter of this name that starts; a shim of pyenv may not."""
    folders = [
        Path(folder)
        for folder in os.environ.get("PATH", "").split(os.pathsep)
        if folder
    ]
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv")
    folders += sorted(
        pyenv.glob(f"versions/{name.removeprefix('python')}*/bin"), reverse=True
    )
    for path in (folder / name for folder in folders):
        if path.exists() and succeeds([str(path), "-c", "import ensurepip"]):
            return str(path)
    return None


def succeeds(command: list[str]) -> bool:
    """Return whether a command ends with exit code 0; what it prints is dropped."""
    return (
        subprocess.run(command, check=False, capture_output=True, timeout=60).returncode  # noqa: S603
        == 0
    )


def trial(python: str, versions: str) -> str | None:
    """Install into a new environment and run the tests; return what was printed if one failed."""
    folder = WORK / f"{Path(python).name}-{versions}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    inner = str(folder / "venv" / "bin" / "python")
    uv = [sys.executable, "-m", "uv"]
    resolution = "highest" if versions == "newest" else "lowest-direct"
    wheels = ["--no-build", "--resolution", resolution, "--python", inner]
    required = str(folder / "requirements.txt")
    environment = os.environ | {"HILSERVER_CACHE_DIR": str(folder / "cache")}
    environment.pop("PYTHONPATH", None)  # it is what was installed that is tested
    for command in (
        [python, "-m", "venv", str(folder / "venv")],
        [
            *uv,
            "pip",
            "compile",
            "--quiet",
            *wheels,
            "--output-file",
            required,
            "pyproject.toml",
        ],
        [*uv, "pip", "install", "--quiet", "--python", inner, "-r", required, *TESTS],
        [*uv, "pip", "install", "--quiet", "--python", inner, "--no-deps", "."],
        [
            inner,
            "-m",
            "pytest",
            "-q",
            "-m",
            "long",
            "-p",
            "no:cacheprovider",
            "tests/pythons",
        ],
    ):
        done = subprocess.run(  # noqa: S603 (the commands are ours)
            command,
            cwd=ROOT,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )
        if done.returncode != 0:
            return done.stdout
    return None


def main() -> int:
    """Run all trials, as many at once as there are cores; print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--unchanged", action="store_true", help="only compare the stamp"
    )
    parser.add_argument(
        "only", nargs="*", help="interpreters, such as python3.12; default: all"
    )
    args = parser.parse_args()
    stamp = dependencies()
    if args.unchanged:
        return 0 if STAMP.exists() and STAMP.read_text("utf-8").strip() == stamp else 1

    names = args.only or NAMES
    found = {name: find(name) for name in names}
    trials = [(n, v) for n in names if found[n] for v in ("newest", "lowest")]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        outputs = list(pool.map(lambda t: trial(str(found[t[0]]), t[1]), trials))
    for (name, versions), output in zip(trials, outputs, strict=True):
        print(
            f"{name}, {versions} versions: {'passed' if output is None else 'failed'}"
        )
        if output is not None:
            print(output)
    absent = [name for name in names if not found[name]]
    for name in absent:
        print(f"{name}: not on this computer, so not tested")

    failed = any(output is not None for output in outputs)
    if not failed and not absent and not args.only:
        STAMP.write_text(stamp + "\n", "utf-8")
        print(
            f"{STAMP.relative_to(ROOT)} says that these dependencies have passed: commit it"
        )
    return 1 if failed or not trials else 0


if __name__ == "__main__":
    sys.exit(main())
