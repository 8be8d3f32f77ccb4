"""What fits together, and what is refused with file, line and key."""

import pytest

from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble, assemble_config
from hilserver.errors import ConfigError

BLOCK = """
from hilserver.plant.blocks import Output, block

@block(inputs=("u",), outputs=(Output("x_m", unit="m", low=-1.0, high=1.0),),
       parameters={"gain": 1.0})
def follow(dt_s, u, y, x, p):
    y[0] = p[0] * u[0]
"""


def write(folder, blocks):
    (folder / "own.py").write_text(BLOCK)
    path = folder / "config.yaml"
    path.write_text("blocks:\n" + "".join(f"  - {{{block}}}\n" for block in blocks))
    return path


ONE = "name: {}, function: 'own.py:follow', slice: sensors, inputs: {{u: pose.x_m}}"


@pytest.mark.parametrize(
    ("blocks", "complaint"),
    [
        (
            [ONE.format("a"), ONE.format("a")],
            ":3: blocks[1].name: two blocks have the name 'a'",
        ),
        ([ONE.format("audit")], ":2: blocks[0].name: 'audit' is reserved"),
        ([ONE.format("pose")], ":2: blocks[0].name: 'pose' is reserved"),
        (
            [ONE.format("a").replace("pose.x_m", "pose.z_m")],
            ":2: blocks[0].inputs.u: there is no",
        ),
        (
            [ONE.format("a").replace("inputs: {u", "inputs: {v")],
            ":2: blocks[0].inputs: input 'u'",
        ),
        (
            [ONE.format("a") + ", parameters: {g: 1}"],
            ":2: blocks[0].parameters.g: ",
        ),
        (
            [ONE.format("a").replace("sensors", "publish")],
            ":2: blocks[0].slice: there is no",
        ),
    ],
)
def test_blocks_that_do_not_fit(tmp_path, blocks, complaint):
    with pytest.raises(ConfigError) as caught:
        assemble(write(tmp_path, blocks))
    assert complaint in str(caught.value)


def test_the_identity_tells_apart_what_cannot_continue_each_other(tmp_path):
    first = assemble(write(tmp_path, [ONE.format("a")])).identity
    assert assemble(write(tmp_path, [ONE.format("a")])).identity == first
    other = assemble(
        write(tmp_path, [ONE.format("a") + ", parameters: {gain: 2}"])
    ).identity
    assert other != first
    slower = Config.model_validate({"scheduler": {"slices": {"sensors": 20}}})
    assert assemble_config(slower).identity != assemble_config(Config()).identity


def test_slices_of_the_plant_come_first():
    assembly = assemble_config(
        Config.model_validate({"scheduler": {"slices": {"aux": 5}}})
    )
    assert next(s.name for s in assembly.slices if s.compiled) == "plant"
    assert [s.compiled for s in assembly.slices] == sorted(
        (s.compiled for s in assembly.slices), reverse=True
    )
