"""Every complaint about a configuration names file, line and key."""

import pytest
from pydantic import BaseModel, ConfigDict, Field

from hilserver.config.loading import load
from hilserver.errors import ConfigError


class Peer(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str
    publishing_ms: float = Field(50.0, gt=0)


class Root(BaseModel):
    model_config = ConfigDict(extra="forbid")
    peers: list[Peer] = []
    backend: str = "thread"


def complaint(tmp_path, text):
    path = tmp_path / "config.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ConfigError) as caught:
        load(path, Root)
    return str(caught.value).replace(str(path), "config.yaml")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "peers:\n  - name: a\n    publishing_s: 0.05\n",
            "config.yaml:3: unknown key 'peers[0].publishing_s'; did you mean 'publishing_ms'?",
        ),
        (
            "publishing_ms: 5\n",
            "config.yaml:1: unknown key 'publishing_ms'; did you mean 'peers.publishing_ms'?",
        ),
        (
            "\n\nbackendd: x\n",
            "config.yaml:3: unknown key 'backendd'; did you mean 'backend'?",
        ),
        (
            "peers:\n  - publishing_ms: 5\n",
            "config.yaml:2: key 'peers[0].name' is missing",
        ),
        (
            "peers:\n  - name: a\n    publishing_ms: 50 ms\n",
            "config.yaml:3: peers[0].publishing_ms: '50 ms' is not valid; it should be a number",
        ),
        (
            "peers:\n  - name: a\n    publishing_ms: -1\n",
            "config.yaml:3: peers[0].publishing_ms: -1 is not valid; it should be greater than 0",
        ),
        (
            "backend: a\nbackend: b\n",
            "config.yaml:2: key 'backend' is already in line 1;",
        ),
        ("peers: [\n", "config.yaml:2: not YAML"),
        ("a: b: c\n", "config.yaml:1: not YAML"),
        (b"backend: \xff\n", "config.yaml:1: byte 9 is not UTF-8"),
        ("- 1\n", "config.yaml:1: "),
        ("backend: !!python/object:os.system x\n", "config.yaml:1: "),
        ("backend: 2024-13-45\n", "config.yaml:1: a value cannot be read: month"),
        ("? [a]\n: 1\n", "config.yaml:1: "),
        (
            "\nbackend: !!float ''\n",
            "config.yaml:2: a value cannot be read: '' is not type float",
        ),
        (
            "backend: !!int ''\n",
            "config.yaml:1: a value cannot be read: '' is not type int",
        ),
        (
            "backend: !!bool maybe\n",
            "config.yaml:1: a value cannot be read: 'maybe' is not type bool",
        ),
        (
            "backend: !!timestamp x\n",
            "config.yaml:1: a value cannot be read: 'x' is not type timestamp",
        ),
        ('\nbackend: "a\\0b"\n', "config.yaml:2: a text contains the character NUL"),
    ],
)
def test_one_sentence_with_file_line_and_key(tmp_path, text, expected):
    assert complaint(tmp_path, text).startswith(expected)


def test_every_complaint_is_told_at_once(tmp_path):
    text = complaint(tmp_path, "x: 1\ny: 2\n")
    assert [line.split(":")[1] for line in text.splitlines()] == ["1", "2"]


def test_absent_file(tmp_path):
    with pytest.raises(ConfigError, match="no such file"):
        load(tmp_path / "absent.yaml", Root)


@pytest.mark.parametrize("nothing", ["~\n", "# a remark\n", "---\n"])
def test_nothing_but_a_remark_means_the_defaults(tmp_path, nothing):
    (tmp_path / "config.yaml").write_text(nothing)
    assert load(tmp_path / "config.yaml", Root) == Root()


def test_an_empty_file_means_the_defaults(tmp_path):
    path = tmp_path / "config.yaml"
    path.write_text("# nothing\n")
    assert load(path, Root).backend == "thread"
