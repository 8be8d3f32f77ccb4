"""Compiled kernels are kept by the text of all that they call, wherever it lies."""

import importlib.util
import os
import subprocess
import sys
from collections import Counter

import numba
import pytest
from numba.core import config

from hilserver.cache import KERNELS, Shelf
from hilserver.compiled import cache, kernel, kernel_hash
from hilserver.compiled.histogram import bucket_index
from hilserver.image.ring import copy_latest
from hilserver.io.shield.framing import feed
from hilserver.program.compiling import telling

TINY = """
from hilserver.compiled import kernel

@kernel("int64(int64)")
def twice(x):
    return 2 * x
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "_PACKAGE", tmp_path)
    for stamp in (cache.source_stamp, cache._room_stamp):
        stamp.cache_clear()
    yield tmp_path
    for stamp in (cache.source_stamp, cache._room_stamp):
        stamp.cache_clear()


@pytest.fixture
def shelf(tmp_path, monkeypatch):
    monkeypatch.setenv("HILSERVER_CACHE_DIR", str(tmp_path / "cache"))
    shelf = Shelf("kernels-1")
    monkeypatch.setattr(cache, "shelf", lambda: shelf)
    return shelf


def imported(folder, text=TINY):
    """Import a module of a folder under always the same name; also return what was compiled."""
    folder.mkdir(exist_ok=True)
    (folder / "tiny.py").write_text(text)
    cache.source_stamp.cache_clear()
    spec = importlib.util.spec_from_file_location("tiny", folder / "tiny.py")
    module = importlib.util.module_from_spec(spec)
    module.__dict__["__cached__"] = None
    sys.modules["tiny"] = module
    sys.dont_write_bytecode, before = True, sys.dont_write_bytecode
    names = []
    try:
        with telling(names.append):
            spec.loader.exec_module(module)
    finally:
        sys.dont_write_bytecode = before
    return module, names


def test_a_room_with_another_constant_has_other_kernels(package):
    """The constant stands in one file, the kernel that has it built in stands in another."""
    room = package / "io" / "line"
    room.mkdir(parents=True)
    (room / "words.py").write_text("BYTES = 22\n")
    before = cache.source_stamp(room / "framing.py")
    (room / "words.py").write_text("BYTES = 23\n")
    cache.source_stamp.cache_clear()
    cache._room_stamp.cache_clear()
    assert cache.source_stamp(room / "framing.py") != before


def test_every_kernel_lies_in_the_folder_of_the_hash():
    for kept in (copy_latest, feed, bucket_index):
        assert kept._cache.cache_path.endswith(f"{KERNELS}{kernel_hash()}")


def test_every_byte_of_a_source_counts(tmp_path):
    """Only Python itself knows which text computes: a guess would run old kernels."""
    source = tmp_path / "step.py"
    source.write_text("LIMIT = 3\n")
    before = cache.hash_of([source])
    source.write_text("LIMIT = 3  # V\n")
    assert cache.hash_of([source]) != before


def test_another_place_of_the_same_text_uses_the_same_cache(shelf, tmp_path):
    assert imported(tmp_path / "one")[1] == ["twice"]
    module, compiled = imported(tmp_path / "two")
    assert compiled == []
    assert module.twice(4) == 8


def test_another_text_at_the_same_place_does_not(shelf, tmp_path):
    imported(tmp_path / "one")
    module, compiled = imported(tmp_path / "one", TINY.replace("2 *", "3 *"))
    assert compiled == ["twice"]
    assert module.twice(4) == 12


@pytest.mark.parametrize(
    "damage", [lambda b: b[:-100], lambda b: b[:2000] + bytes([b[2000] ^ 1]) + b[2001:]]
)
def test_damaged_code_is_compiled_anew_and_never_executed(shelf, tmp_path, damage):
    imported(tmp_path / "one")
    [path] = shelf.folder.glob("*.nbc")
    path.write_bytes(damage(path.read_bytes()))
    module, compiled = imported(tmp_path / "one")
    assert compiled == ["twice"]
    assert module.twice(4) == 8

    _, compiled = imported(tmp_path / "one")
    assert compiled == []
    assert imported(tmp_path / "one")[1] == []


def test_code_of_another_processor_is_compiled_anew(shelf, tmp_path, monkeypatch):
    imported(tmp_path / "one")
    monkeypatch.setattr(
        "numba.core.codegen.CPUCodegen.magic_tuple", lambda _: ("triple", "another", "")
    )
    assert imported(tmp_path / "one")[1] == ["twice"]
    assert len(list(shelf.folder.glob("*.nbc"))) == 2


def test_what_cannot_be_kept_is_compiled_each_time(shelf, tmp_path, monkeypatch):
    monkeypatch.setattr(shelf, "put", lambda *_: None)
    for _ in range(2):
        module, compiled = imported(tmp_path / "one")
        assert compiled == ["twice"]
        assert module.twice(4) == 8


def test_a_kernel_that_calls_itself_is_found_again(shelf, tmp_path):
    text = TINY.replace(
        "    return 2 * x\n", "    return 0 if x == 0 else 2 + twice(x - 1)\n"
    )
    assert imported(tmp_path / "one", text)[1] == ["twice"]
    module, compiled = imported(tmp_path / "one", text)
    assert compiled == []
    assert module.twice(4) == 8


def test_a_users_own_functions_keep_their_own_cache(tmp_path, monkeypatch):
    before = config.CACHE_DIR
    kernel()(lambda x: x)
    assert before == config.CACHE_DIR
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    own = numba.njit(cache=True)(lambda x: x)
    assert own(1) == 1
    assert own.stats.cache_path.startswith(str(tmp_path))


def test_where_numba_has_moved_its_own_cache_is_used(shelf, tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "stored", None)
    before = config.CACHE_DIR
    module, _ = imported(tmp_path / "one")
    assert module.twice(4) == 8
    assert before == config.CACHE_DIR
    assert module.twice.stats.cache_path.startswith(
        f"{tmp_path}/cache/kernels-{kernel_hash()}/"
    )


SEVERAL = """
import os, sys, time
from hilserver.cache import Shelf
from hilserver.compiled import cache, sharing
from hilserver.program.compiling import telling
cache.shelf = lambda shelf=Shelf('kernels-1'): shelf
names = []
ready = os.path.join(os.environ['HILSERVER_CACHE_DIR'], f'ready-{sys.argv[1]}')
os.makedirs(os.path.dirname(ready), exist_ok=True)
open(ready, 'w').close()
end = time.monotonic() + 30
while len([n for n in os.listdir(os.path.dirname(ready)) if n.startswith('ready')]) < 2:
    assert time.monotonic() < end
    time.sleep(0.01)
try:
    with telling(names.append), sharing.shared(cache.shelf, is_helper=sys.argv[2:] == ['helper']):
        import many
        if sys.argv[2:]:
            sharing.current().work()
            assert many.last(1) == 45
finally:
    print(*names)
"""

MANY = "from hilserver.compiled import kernel\n" + "".join(
    f"""
@kernel("int64(int64)")
def {"last" if n == 8 else f"f{n}"}(x):
    total = x
    for i in range({n}):
        total += i * {n} if i < 0 else 0
    return total + {f"f{n - 1}(x) + {n} - x" if n else "8"}
"""
    for n in range(9)
)


@pytest.mark.parametrize(
    "words", [[("1", "all"), ("2", "helper")], [("1", "all"), ("2", "all")]]
)
def test_processes_at_once_compile_each_function_once(tmp_path, words):
    (tmp_path / "many.py").write_text(MANY)
    env = os.environ | {
        "HILSERVER_CACHE_DIR": str(tmp_path / "cache"),
        "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path]),
    }
    both = [
        subprocess.Popen(
            [sys.executable, "-c", SEVERAL, *word],
            env=env,
            stdout=subprocess.PIPE,
            text=True,
        )
        for word in words
    ]
    compiled = [process.communicate(timeout=120)[0].split() for process in both]
    assert [process.returncode for process in both] == [0, 0]
    count = Counter(name for names in compiled for name in names)
    assert count == dict.fromkeys([*(f"f{n}" for n in range(8)), "last"], 1)
