"""Three versions of this project in a repository, which differ in their number alone.

Their code and their commands are ours. How a wheel is made is not, as the container has no network
from which pip could fetch what that needs.
"""

import shutil
import subprocess
from pathlib import Path

from tests.systemd.container import ROOT

VERSIONS = ("v1", "v2", "v3")
_PROJECT = """[build-system]
requires = []
build-backend = "backend"
backend-path = ["."]
"""
_BACKEND = """
import pathlib, re, zipfile

def build_wheel(folder, settings=None, metadata=None):
    number = re.search(r'__version__ = "(.+)"', open("hilserver/__init__.py").read())[1]
    name, info = f"hilserver-{number}", f"hilserver-{number}.dist-info"
    texts = {
        "METADATA": f"Metadata-Version: 2.1\\nName: hilserver\\nVersion: {number}\\n",
        "WHEEL": "Wheel-Version: 1.0\\nRoot-Is-Purelib: true\\nTag: py3-none-any\\n",
        "entry_points.txt": "[console_scripts]\\nhilserver = hilserver.commands:main\\n",
        "RECORD": "",
    }
    wheel = f"{name}-py3-none-any.whl"
    with zipfile.ZipFile(pathlib.Path(folder, wheel), "w") as packed:
        for path in pathlib.Path("hilserver").rglob("*"):
            packed.write(path)
        for path in pathlib.Path("deploy/systemd").iterdir():
            packed.write(path, f"{name}.data/data/share/hilserver/systemd/{path.name}")
        for file, text in texts.items():
            packed.writestr(f"{info}/{file}", text)
    return wheel
"""


def make_repository(folder: Path) -> Path:
    """Return a repository with a tag for each version."""
    for part in ("hilserver", "deploy/systemd"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / part, folder / part, ignore=ignored)
    shutil.copy(ROOT / "constraints.txt", folder)
    (folder / "pyproject.toml").write_text(_PROJECT, encoding="utf-8")
    (folder / "backend.py").write_text(_BACKEND, encoding="utf-8")
    git(folder, "init", "--quiet")
    for version in VERSIONS:
        first = folder / "hilserver/__init__.py"
        text = first.read_text(encoding="utf-8").partition("__version__")[0]
        first.write_text(f'{text}__version__ = "{version[1:]}.0.0"\n', encoding="utf-8")
        git(folder, "add", "--all")
        git(folder, "commit", "--quiet", f"--message={version}")
        git(folder, "tag", version)
    return folder


def git(folder: Path, *words: str) -> None:
    """Run git in a folder; as nobody in particular."""
    who = ("-c", "user.name=test", "-c", "user.email=test@localhost")
    subprocess.run(["git", *who, *words], cwd=folder, check=True, timeout=300)
