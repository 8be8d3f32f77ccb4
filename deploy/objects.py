"""Compiles what is known before anybody installs it: ``make wheel`` puts the result into the wheel.

The objects are made by the same functions that a start calls, for any processor of this
architecture and for the versions of numba, llvmlite and numpy that are installed here.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from importlib.metadata import distribution
from importlib.util import find_spec
from pathlib import Path

EXAMPLES = Path(__file__).parents[1] / "examples"
CPU_NAME, CPU_FEATURES = "generic", ""
LIMIT_S = 1800
ANY_PORT = """
image: {name: auto}
opcua: {endpoint: "opc.tcp://127.0.0.1:0/hilserver"}
metrics: {port: 0}
page: {port: 0}
scheduler: {limits: {single_overrun_ms: null, consecutive_overruns: null}}
"""


def main() -> int:
    """Make the objects; print how many there are and how large."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "out", type=Path, help="folder for the objects; what it holds is removed"
    )
    parser.add_argument(
        "--examples", type=Path, default=EXAMPLES, help="folder of the examples"
    )
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="hilserver-objects-") as name:
        work = Path(name)
        for words in commands(args.examples, work):
            run(words, work)
        found = collect(work / "cache", args.out)
    size = sum(path.stat().st_size for path in found)
    print(f"{args.out}: {len(found)} compiled functions, {size / 1e6:.1f} MB")
    return 0


def commands(examples: Path, work: Path) -> Iterator[list[str]]:
    """Yield the command lines, after ``python -m``, that compile what the examples need."""
    start = ["hilserver.commands.compiled_start", "--alone", str(os.getpid())]
    yield start
    beside = work / "beside_others.yaml"  # a daemon may run on this computer
    beside.write_text(ANY_PORT, encoding="utf-8")
    yield ["hilserver", "run", "--demo", "--duration", "1", "-c", str(beside)]
    if not examples.is_dir():
        return
    for path in sorted(examples.glob("*/config.yaml")):
        if path.parent.name != "body" or find_spec("mujoco") is not None:
            yield [*start, "--config", str(path)]
    table = examples / "foreign-csv"
    yield ["hilserver", "diagnose", str(table / "drive.csv"), "-c", str(table / "config.yaml"),
           "--mapping", str(table / "mapping.yaml"), "--out", str(work / "report")]  # fmt: skip
    yield ["hilserver", "sweep", str(examples / "sweep/sweep.yaml"), "--dry-run",
           "-o", str(work / "sweep")]  # fmt: skip


def run(words: list[str], work: Path) -> None:
    """Run one of our programs with a cache of its own; what it says appears if it fails."""
    own = {
        "HILSERVER_CACHE_DIR": str(work / "cache"),
        "NUMBA_CPU_NAME": CPU_NAME,
        "NUMBA_CPU_FEATURES": CPU_FEATURES,
    }
    done = subprocess.run(  # noqa: S603 - words of this script
        [sys.executable, "-m", *words],
        check=False,
        env=os.environ | own,
        text=True,
        timeout=LIMIT_S,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    if done.returncode:
        raise SystemExit(
            f"{' '.join(words)} ended with {done.returncode}:\n{done.stdout[-4000:]}"
        )


def collect(cache: Path, out: Path) -> list[Path]:
    """Put what the programs have compiled into `out`, as `hilserver.compiled.supplied` reads it."""
    from hilserver.compiled import kernel_hash  # noqa: PLC0415 - not while the others compile
    from hilserver.compiled.supplied import MADE_WITH, environment  # noqa: PLC0415

    found = sorted((cache / f"kernels-{kernel_hash()}").glob("*.nbc"))
    if not found:
        raise SystemExit(
            "nothing was compiled: this installation brings its compiled code along"
        )
    shutil.rmtree(out, ignore_errors=True)
    folder = out / kernel_hash()
    folder.mkdir(parents=True)
    kept = [Path(shutil.copyfile(path, folder / path.name)) for path in found]
    about = environment() | {"platform": numbas_platform()}
    (out / MADE_WITH).write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")
    # Each object has the wrappers around a function, and the release of an array, out of numba.
    [terms] = [
        f for f in distribution("numba").files or () if re.search(r"/LICENSE$", str(f))
    ]
    (out / "LICENSE.numba").write_text(
        terms.read_text(encoding="utf-8"), encoding="utf-8"
    )
    return kept


def numbas_platform() -> str:
    """Return the platform that numba's own wheel names.

    The objects call the C library, Python and numba by names without a version, so they run where
    numba does.
    """
    tags = re.findall(
        r"^Tag: [^-]+-[^-]+-(\S+)$",
        distribution("numba").read_text("WHEEL") or "",
        re.M,
    )
    if not tags:
        raise SystemExit(
            "numba was not installed from a wheel: nothing names the platform"
        )
    return ".".join(sorted(tags))


if __name__ == "__main__":
    sys.exit(main())
