"""Own blocks: the documented example runs, wrong ones are refused with file and line."""

import re
from pathlib import Path

import numpy as np
import pytest

from hilserver.plant.blocks import BlockError, load_block

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "own-block.md"


@pytest.fixture
def example(tmp_path):
    code = re.search(
        r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL
    )[1]
    (tmp_path / "load_cell.py").write_text(code, encoding="utf-8")
    return code, load_block("load_cell.py:load_cell", tmp_path)


def test_the_example_is_short(example):
    assert len([line for line in example[0].splitlines() if line.strip()]) <= 15


def test_the_example_declares_what_the_page_says(example):
    block = example[1]
    assert (block.name, block.inputs, len(block.state)) == (
        "load_cell",
        ("duty_pct",),
        1,
    )
    assert block.parameters == {"gain_n_pct": 0.4, "lag_s": 0.1}
    output = block.outputs[0]
    assert (output.name, output.unit, output.low, output.high) == (
        "force_n",
        "N",
        -50.0,
        50.0,
    )
    assert block.source.name == "load_cell.py"


def test_the_example_runs_compiled(example):
    block = example[1]
    u, y, x = np.array([50.0]), np.zeros(1), np.zeros(1)
    p = np.array(list(block.parameters.values()))
    expected = 0.0
    for _ in range(100):
        block.function(0.01, u, y, x, p)
        expected += 0.01 / 0.11 * (20.0 - expected)
        assert y[0] == pytest.approx(expected, rel=1e-12)
    assert len(block.function.nopython_signatures) == 1


HEAD = "from hilserver.plant.blocks import Output, block\n"
F = "def f(dt_s, u, y, x, p):\n    "


def declared(arguments, body="pass", function=F):
    return f"{HEAD}@block({arguments})\n{function}{body}\n"


ONE = 'outputs=(Output("a"),)'


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("", "no function 'f'"),
        (F + "pass\n", "not declared"),
        (
            declared(ONE, function="def f(dt_s, u, y, x): "),
            r"own\.py:2 must take \(dt_s, u, y",
        ),
        (declared(ONE, "y[0] = u.nothing"), r"own\.py:4 does not compile"),
        (declared(ONE, "y[0] = unknown"), r"own\.py:4 does not compile"),
        (declared(""), "no output"),
        (declared('outputs=(Output("A b"),)'), "'A b' in outputs"),
        (declared('outputs=(Output("a"), Output("a"))'), "appears twice"),
        (declared('outputs=(Output("a", low=1, high=1),)'), "low below high"),
        (declared(ONE + ', parameters={"g": float("nan")}'), "finite"),
        (declared(ONE + ', parameters={"g": "1"}'), "finite"),
        (declared('outputs=("a",)'), r"'a' in outputs is not an output; write Output"),
        (declared('outputs=(Output("a", low="0"),)'), "low below high"),
        (declared('outputs=(Output("a", unit=None),)'), "must be strings"),
        (
            declared(ONE + ', inputs="abc"'),
            r"own\.py:2 failed on import: inputs and state are",
        ),
        ("raise SystemExit(3)\n", r"own\.py:1 failed on import"),
        ("import nothing_of_this_name\n", r"own\.py:1 failed on import"),
        ("def f(:\n", r"own\.py:1 failed on import"),
    ],
)
def test_refused_in_one_sentence(tmp_path, code, words):
    (tmp_path / "own.py").write_text(code)
    with pytest.raises(BlockError, match=words) as caught:
        load_block("own.py:f", tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "reference", ["own.py", ":f", "own.py:", "none.py:f", "no.module:f"]
)
def test_wrong_references(tmp_path, reference):
    with pytest.raises(BlockError, match=re.escape(reference)):
        load_block(reference, tmp_path)


def test_initial_state_and_unused_inputs(tmp_path):
    (tmp_path / "own.py").write_text(
        declared(ONE + ', state={"s": 2.5}', "y[0] = x[0]")
    )
    block = load_block("own.py:f", tmp_path)
    y = np.zeros(1)
    block.function(
        0.01, np.zeros(0), y, np.array(list(block.state.values())), np.zeros(0)
    )
    assert y[0] == 2.5
