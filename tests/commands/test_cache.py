"""`hilserver cache` shows what is kept and clears it, and touches nothing else."""

import os

import pytest

from hilserver.cache import Shelf
from hilserver.commands import main
from hilserver.compiled import cache, kernel_hash
from hilserver.compiled.supplied import Supplied


@pytest.fixture
def here(capsys):
    def run(*words):
        code = main(words)
        return code, *capsys.readouterr()

    return run


@pytest.fixture
def kept(tmp_path, monkeypatch):
    monkeypatch.setenv("HILSERVER_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    for name in (f"kernels-{kernel_hash()}", "kernels-old", "opcua"):
        Shelf(name).put("a", bytes(250_000))
    os.utime(tmp_path / "cache" / "kernels-old", (0, 0))
    (tmp_path / "cache" / "holiday").mkdir()
    return tmp_path / "cache"


def test_it_shows_folder_size_and_age(kept, here):
    code, out, said = here("cache")
    assert (code, said) == (0, "")
    first, *rows = out.splitlines()
    assert first == f"{kept}: 0.8 MB"
    assert len(rows) == 3
    [mine] = [row for row in rows if "this version" in row]
    assert kernel_hash() in mine
    assert "used just now" in mine
    [old] = [row for row in rows if "kernels-old" in row]
    assert "0.3 MB" in old
    assert "days ago" in old


def test_it_clears_what_is_its_own(kept, here):
    assert here("cache", "clear")[0] == 0
    assert [path.name for path in kept.iterdir()] == ["holiday"]
    code, out, _ = here("cache", "clear")
    assert (code, out) == (0, f"{kept}: nothing is kept\n")
    assert "nothing is kept" in here("cache")[1]


def test_what_cannot_be_removed_is_one_sentence(kept, here, monkeypatch):
    def refused(path):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr("shutil.rmtree", refused)
    code, _, said = here("cache", "clear")
    assert code == 1
    first = min(kernel_hash(), "old")
    assert (
        said
        == f"hilserver: {kept}: kernels-{first} cannot be removed: permission denied\n"
    )


def test_it_shows_what_the_installation_brought_along(
    kept, here, tmp_path, monkeypatch
):
    supplied = Supplied("1", tmp_path / "objects")
    supplied.folder.mkdir(parents=True)
    (supplied.folder / "a.nbc").write_bytes(bytes(500_000))
    monkeypatch.setattr(cache, "supplied", lambda: supplied)
    assert f"{supplied.folder}: 0.5 MB, came with this installation" in here("cache")[1]
    assert here("cache", "clear")[0] == 0
    assert (supplied.folder / "a.nbc").exists()
