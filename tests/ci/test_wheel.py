"""What `make wheel` builds works where there is no checkout: the first drive, and the test kit."""

import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TEST = """
async def test_it_drives(hil):
    hil.write("wheels.setpoints_rpm", [20.0, 20.0, -20.0, -20.0])
    await hil.run_for(0.5)
    assert hil.read("wheel.fl.speed_rpm") > 5
"""
pytestmark = pytest.mark.long  # it downloads what hilserver needs, and compiles


CONFIG = """
image: {name: wheel-test}
opcua: {endpoint: "opc.tcp://127.0.0.1:0/hilserver"}
metrics: {port: 0}
page: {port: 0}
"""


def run(*command, cwd):
    """Return all that a command prints."""
    words = [str(word) for word in command]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    done = subprocess.run(words, check=False, cwd=cwd, timeout=900, env=environment, **pipes)
    assert done.returncode == 0, done.stdout
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    out = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--outdir", out, ".", cwd=ROOT)
    run(sys.executable, "-m", "twine", "check", "--strict", *out.iterdir(), cwd=out)
    (path,) = out.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """The programs of an environment with nothing but the wheel, and a folder to work in."""
    folder = tmp_path_factory.mktemp("elsewhere")
    run(sys.executable, "-m", "venv", folder / "venv", cwd=folder)
    bin_ = folder / "venv" / "bin"
    run(
        bin_ / "python", "-m", "pip", "install", "-q", wheel, "pytest", "pytest-asyncio", cwd=folder
    )
    return bin_, folder


def test_the_wheel_has_one_package_at_its_top_and_the_page(wheel):
    with zipfile.ZipFile(wheel) as file:
        names = file.namelist()
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not re.search(r"[.](data|dist-info)$", top)} == {"hilserver"}
    assert "hilserver/io/page/static/index.html" in names
    assert not [name for name in names if name.startswith(("tests", "benchmarks"))]


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
