"""What `make wheels` builds works where there is no checkout: the first drive, and the test kit.

The compiled code that it brings along spares the compiler, and gives the bits of native code.
"""

import json
import os
import re
import runpy
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = runpy.run_path(str(ROOT / "deploy" / "wheels.py"))
PYTHONS = SCRIPT["pythons"]
TEST = """
async def test_it_drives(hil):
    hil.write("wheels.setpoints_rpm", [20.0, 20.0, -20.0, -20.0])
    await hil.run_for(0.5)
    assert hil.read("wheel.fl.speed_rpm") > 5
"""
pytestmark = pytest.mark.long  # it downloads what hilserver needs, and compiles

ALONE = ("PYTHONPATH", "HOME")
LIMIT_BYTES = 10_000_000
OBJECTS = "hilserver/compiled/objects/"
UV = (sys.executable, "-m", "uv")
VERSIONS = ("--constraint", ROOT / "constraints.txt")
SCENARIO = """
steps:
  - {at_s: 0.0, write: {control.mode: 1, twist.linear_m_s: 0.3}}
  - {at_s: 2.0, write: {twist.angular_rad_s: 0.6}}
  - {at_s: 4.0, write: {twist.linear_m_s: -0.2}}
"""
CONFIG = """
image: {name: wheel-test}
opcua: {endpoint: "opc.tcp://127.0.0.1:0/hilserver"}
metrics: {port: 0}
page: {port: 0}
"""


def run(*command, cwd, without=("PYTHONPATH",), **environment):
    """Return all that a command prints."""
    words = [str(word) for word in command]
    rest = {name: value for name, value in os.environ.items() if name not in without}
    environment = rest | environment
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    done = subprocess.run(
        words, check=False, cwd=cwd, timeout=900, env=environment, **pipes
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


@pytest.fixture(scope="module", params=PYTHONS["NAMES"])
def python(request):
    path = PYTHONS["find"](request.param)
    if path is None:
        pytest.skip(f"{request.param} is not on this computer")
    return path


@pytest.fixture(scope="module")
def wheel(python, tmp_path_factory):
    out = tmp_path_factory.mktemp("dist")
    SCRIPT["build"](python, out)
    run(
        sys.executable,
        "-m",
        "twine",
        "check",
        "--strict",
        *out.glob("hilserver-*"),
        cwd=out,
    )
    (path,) = out.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def installed(python, wheel, tmp_path_factory):
    """The programs of an environment with nothing but the wheel, and a folder to work in."""
    folder = tmp_path_factory.mktemp("elsewhere")
    bin_ = folder / "venv" / "bin"
    run(*UV, "venv", "--python", python, folder / "venv", cwd=folder)
    kit = (wheel, "pytest", "pytest-asyncio")
    words = ("pip", "install", "--python", bin_ / "python", *VERSIONS, *kit)
    run(*UV, *words, cwd=folder)
    (folder / "first.yaml").write_text(CONFIG)
    return bin_, folder


@pytest.fixture(scope="module")
def objects(installed):
    """The compiled code of this installation."""
    [about] = (installed[1] / "venv").glob(
        f"lib/*/site-packages/{OBJECTS}made_with.json"
    )
    return about.parent


def test_the_wheel_has_one_package_at_its_top_and_the_page(wheel):
    with zipfile.ZipFile(wheel) as file:
        names = file.namelist()
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not re.search(r"[.](data|dist-info)$", top)} == {
        "hilserver"
    }
    assert "hilserver/io/page/static/index.html" in names
    assert not [name for name in names if name.startswith(("tests", "benchmarks"))]


def test_it_names_its_interpreter_and_platform_and_the_terms_of_numba(python, wheel):
    interpreter = f"cp{Path(python).name.removeprefix('python').replace('.', '')}"
    assert re.search(
        f"-{interpreter}-{interpreter}-manylinux[0-9a-z_.]+[.]whl$", wheel.name
    )
    with zipfile.ZipFile(wheel) as file:
        about = {
            Path(name).name: name for name in file.namelist() if ".dist-info/" in name
        }
        assert b"Root-Is-Purelib: false" in file.read(about["WHEEL"])
        assert b"License-File: LICENSE.numba" in file.read(about["METADATA"])
        assert b"Anaconda" in file.read(about["LICENSE.numba"])
        packed = [
            file.getinfo(n).compress_size
            for n in file.namelist()
            if n.startswith(OBJECTS)
        ]
    assert len(packed) > 50
    assert sum(packed) < LIMIT_BYTES


def test_without_compiled_code_it_is_for_every_interpreter(tmp_path):
    run(sys.executable, "-m", "build", "--wheel", "--outdir", tmp_path, ".", cwd=ROOT)
    [path] = tmp_path.glob("*.whl")
    assert path.name.endswith("-py3-none-any.whl")
    with zipfile.ZipFile(path) as file:
        assert not [name for name in file.namelist() if name.startswith(OBJECTS)]


def test_the_first_start_compiles_nothing(installed):
    bin_, folder = installed
    words = ["run", "--demo", "--duration", "3", "-c", "first.yaml"]
    cache = str(folder / "cache")
    said = run(
        bin_ / "hilserver", *words, cwd=folder, without=ALONE, HILSERVER_CACHE_DIR=cache
    )
    assert "compil" not in said
    assert list((folder / "cache").rglob("step_*.py"))  # it is the cache that was used
    assert not list((folder / "cache").rglob("*.nbc"))


@pytest.mark.parametrize(
    "processor", [{}, {"NUMBA_CPU_NAME": "nehalem", "NUMBA_CPU_FEATURES": ""}]
)
def test_it_gives_the_bits_of_native_code(installed, processor, tmp_path):
    bin_, _ = installed
    (tmp_path / "drive.yaml").write_text(SCENARIO)
    words = ("simulate", "drive.yaml", "--duration", "8", "-o")
    cache = {"HILSERVER_CACHE_DIR": str(tmp_path / "cache")}
    run(bin_ / "hilserver", *words, "any.csv", cwd=tmp_path, **cache, **processor)
    assert not list(tmp_path.rglob("*.nbc"))
    native = (sys.executable, "-m", "hilserver")
    run(*native, *words, "native.csv", cwd=tmp_path, PYTHONPATH=str(ROOT))
    assert (tmp_path / "any.csv").read_bytes() == (tmp_path / "native.csv").read_bytes()


def test_one_that_is_damaged_is_compiled_anew(installed, objects):
    bin_, folder = installed
    cache = folder / "cache_beside_damage"
    whole = {path: path.read_bytes() for path in objects.glob("*/step_*.nbc")}
    for path, data in whole.items():
        path.write_bytes(data[:2000] + bytes([data[2000] ^ 1]) + data[2001:])
    try:
        words = ["run", "--duration", "1", "-c", "first.yaml"]
        run(bin_ / "hilserver", *words, cwd=folder, HILSERVER_CACHE_DIR=str(cache))
    finally:
        for path, data in whole.items():
            path.write_bytes(data)
    [compiled] = cache.rglob("*.nbc")
    assert compiled.name.startswith("step_")


def test_other_versions_are_told_in_one_line_and_compiled(installed, objects):
    bin_, folder = installed
    about = objects / "made_with.json"
    whole = about.read_text()
    about.write_text(whole.replace(json.loads(whole)["numba"], "0.1"))
    [hashed] = (path for path in objects.iterdir() if path.is_dir())
    hidden = hashed.rename(hashed.with_name("other"))
    try:
        cache = str(folder / "other_cache")
        words = ["run", "--duration", "1", "-c", "first.yaml"]
        said = run(bin_ / "hilserver", *words, cwd=folder, HILSERVER_CACHE_DIR=cache)
    finally:
        hidden.rename(hashed)
        about.write_text(whole)
    assert (
        len([line for line in said.splitlines() if "made with numba 0.1" in line]) == 1
    )
    assert list(Path(cache).rglob("*.nbc"))


def test_it_drives_and_its_scenarios_are_there(installed):
    bin_, folder = installed
    where = "import hilserver; print(hilserver.__file__)"
    assert str(ROOT) not in run(bin_ / "python", "-c", where, cwd=folder)
    run(bin_ / "hilserver", "scenarios", "list", cwd=folder)
    (folder / "config.yaml").write_text(CONFIG)
    log = folder / "drive.csv"
    words = ["--demo", "--duration", "5", "--record", log, "-c", "config.yaml"]
    run(bin_ / "hilserver", "run", *words, cwd=folder)
    header, *rows = log.read_text().splitlines()
    speed = header.split(",").index("wheel.fl.speed_rpm")
    assert max(abs(float(row.split(",")[speed])) for row in rows) > 5


def test_the_test_kit_is_there(installed):
    bin_, folder = installed
    (folder / "test_robot.py").write_text(TEST)
    words = ["-m", "pytest", "-q", "-o", "asyncio_mode=auto", "test_robot.py"]
    assert "1 passed" in run(bin_ / "python", *words, cwd=folder)
