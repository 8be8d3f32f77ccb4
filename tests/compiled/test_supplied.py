"""Compiled code that came with the installation is used where it fits, and nowhere else."""

import json
import os
import shutil
import subprocess
import sys

import pytest

from hilserver import cache as whole_cache
from hilserver.cache import Shelf
from hilserver.compiled import cache
from hilserver.compiled.supplied import (
    ANY_PROCESSOR,
    MADE_WITH,
    OBJECTS,
    Supplied,
    environment,
)
from tests.compiled.test_cache import TINY, imported

MADE = """
import importlib.util, sys
from hilserver.cache import Shelf
from hilserver.compiled import cache
cache.shelf = lambda shelf=Shelf('kernels-1'): shelf
spec = importlib.util.spec_from_file_location('tiny', sys.argv[1])
module = sys.modules['tiny'] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)
"""
NOBODY = 65534


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """One function, compiled for any processor as `make wheel` does: in a process of its own."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "tiny.py").write_text(TINY)
    name, features = ANY_PROCESSOR
    env = {
        "HILSERVER_CACHE_DIR": str(folder),
        "NUMBA_CPU_NAME": name,
        "NUMBA_CPU_FEATURES": features,
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    words = [sys.executable, "-B", "-c", MADE, str(folder / "tiny.py")]
    subprocess.run(words, check=True, env=os.environ | env, timeout=300)
    [path] = (folder / "kernels-1").glob("*.nbc")
    return path


@pytest.fixture
def own(tmp_path, monkeypatch):
    """Return the user's own shelf, which is empty."""
    monkeypatch.setenv("HILSERVER_CACHE_DIR", str(tmp_path / "cache"))
    shelf = Shelf("kernels-1")
    monkeypatch.setattr(cache, "shelf", lambda: shelf)
    return shelf


@pytest.fixture
def objects(tmp_path, made):
    """Return a folder of objects as in an installation."""
    folder = tmp_path / "objects"
    (folder / "1").mkdir(parents=True)
    shutil.copy(made, folder / "1")
    (folder / MADE_WITH).write_text(json.dumps(environment()))
    return folder


@pytest.fixture
def start(objects, own, tmp_path, monkeypatch):
    """Import the function as a start does; return what is compiled then, and what is told."""

    def started(kernel_hash="1"):
        told = []
        monkeypatch.setattr(whole_cache, "tell", told.append)
        supplied = Supplied(kernel_hash, objects)
        monkeypatch.setattr(cache, "supplied", lambda: supplied)
        module, compiled = imported(tmp_path / "one")
        assert module.twice(4) == 8
        return compiled, told

    return started


def test_what_fits_is_not_compiled_and_the_users_cache_stays_empty(start, own):
    assert start() == ([], [])
    assert not list(own.folder.glob("*.nbc"))


def test_code_of_this_processor_is_used_too(start, own, objects):
    for path in (objects / "1").iterdir():
        path.unlink()
    assert start() == (["twice"], [])
    [path] = own.folder.glob("*.nbc")
    path.rename(objects / "1" / path.name)
    assert start() == ([], [])


def test_the_users_own_comes_first(start, own, objects):
    hidden = objects.rename(objects.with_name("hidden"))
    assert start() == (["twice"], [])
    hidden.rename(objects)
    for path in (objects / "1").iterdir():
        path.write_bytes(b"")
    assert start() == ([], [])


def test_code_for_any_processor_in_the_users_cache_is_not_taken_for_this_one(
    start, own, objects
):
    """Who once set NUMBA_CPU_NAME would have the slower code ever after."""
    for path in (objects / "1").iterdir():
        path.rename(own.folder / path.name)
    assert start() == (["twice"], [])


def test_a_flipped_bit_is_noticed_and_compiled_anew(start, own, objects):
    [path] = (objects / "1").iterdir()
    data = path.read_bytes()
    path.write_bytes(data[:2000] + bytes([data[2000] ^ 1]) + data[2001:])
    assert start() == (["twice"], [])
    assert start() == ([], [])
    assert len(list(own.folder.glob("*.nbc"))) == 1


def test_other_versions_are_compiled_and_named_in_one_line(start, objects):
    (objects / MADE_WITH).write_text(
        json.dumps(environment() | {"numba": "0.1", "numpy": "0.2"})
    )
    compiled, [line] = start("2")
    assert compiled == ["twice"]
    assert "was made with numba 0.1, numpy 0.2, and this is numba " in line
    assert "'pip install numba==0.1 llvmlite==" in line
    assert "\n" not in line
    # Nothing is compiled now, so there is nothing to tell.
    assert start("2") == ([], [])


def test_another_architecture_is_named_and_no_package_is_blamed(start, objects):
    (objects / MADE_WITH).write_text(
        json.dumps(environment() | {"architecture": "z80"})
    )
    compiled, [line] = start("2")
    assert compiled == ["twice"]
    assert "was made with architecture z80, and" in line
    assert "pip" not in line


def test_changed_sources_are_compiled_and_told(start):
    compiled, [line] = start("2")
    assert compiled == ["twice"]
    assert line.startswith("the sources of this installation have been changed")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")
def test_what_belongs_to_somebody_else_is_not_executed(start, objects):
    for path in objects.rglob("*"):
        os.chown(path, NOBODY, -1)
    compiled, [line] = start()
    assert compiled == ["twice"]
    assert f"belongs to another user (id {NOBODY})" in line


def test_a_checkout_has_none_and_says_nothing(own, tmp_path, monkeypatch):
    """Else it would hide what a change of a kernel costs."""
    assert not OBJECTS.exists()
    told = []
    monkeypatch.setattr(whole_cache, "tell", told.append)
    supplied = Supplied("1", tmp_path / "none")
    monkeypatch.setattr(cache, "supplied", lambda: supplied)
    assert imported(tmp_path / "one")[1] == ["twice"]
    assert told == []
