"""The built page in the package is the one that stands in page/."""

import hashlib
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from hilserver.io.page.bundle import FOLDER, TOKEN, load

SOURCE = Path(__file__).parents[2] / "page"
PARTS = (
    "src",
    "public",
    "index.html",
    "package.json",
    "package-lock.json",
    "tsconfig.json",
    "vite.config.js",
)
BUILT = "npm ci && npm run build in page/"


def source_hash():
    digest = hashlib.sha256()
    for part in PARTS:
        path = SOURCE / part
        files = (
            [path] if path.is_file() else [p for p in path.rglob("*") if p.is_file()]
        )
        for file in sorted(files, key=lambda p: p.relative_to(SOURCE).parts):
            name = file.relative_to(SOURCE).as_posix()
            digest.update(f"{name}\n".encode() + file.read_bytes() + b"\n")
    return digest.hexdigest()


def test_the_bundle_was_built_from_the_source():
    built_from = (FOLDER / "source.sha256").read_text(encoding="ascii").strip()
    assert built_from == source_hash(), f"the page has changed: {BUILT}"


def test_the_bundle_is_whole_and_says_its_licences():
    assets = load()
    html = assets["index.html"].body
    assert html.count(TOKEN) == 1
    assert all(part not in html for part in (b"http://", b"https://", b"style="))
    licences = assets["licences.txt"].body.decode()
    assert all(name in licences for name in ("three", "uplot", "MIT"))


def test_the_lock_names_no_host():
    assert '"resolved"' not in (SOURCE / "package-lock.json").read_text(
        encoding="utf-8"
    )


@pytest.mark.page
def test_a_rebuild_gives_the_same_bundle(tmp_path):
    npm = shutil.which("npm")
    assert npm, "npm is needed (make test installs it)"
    modules = SOURCE / "node_modules"
    assert modules.exists(), "npm ci in page/ is missing (make test does it)"
    subprocess.run(
        [npm, "run", "build", "--", "--outDir", str(tmp_path / "static")],
        cwd=SOURCE,
        check=True,
        capture_output=True,
        env=os.environ | {"NO_UPDATE_NOTIFIER": "1"},
    )
    built = {
        p.relative_to(tmp_path / "static"): p.read_bytes()
        for p in files(tmp_path / "static")
    }
    shipped = {p.relative_to(FOLDER): p.read_bytes() for p in files(FOLDER)}
    assert built.keys() == shipped.keys()
    assert all(built[name] == shipped[name] for name in built)


def files(folder):
    return [path for path in folder.rglob("*") if path.is_file()]
