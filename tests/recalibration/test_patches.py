"""The patches of a proposal: forth and back, each a file that the daemon loads."""

import asyncio

import pytest

from hilserver.config.patch import load_patch
from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.builder import build
from hilserver.daemon.patches import Patches
from hilserver.errors import FailedError
from hilserver.recalibration import patches
from hilserver.recalibration.loop import file_of
from hilserver.recalibration.proposals import Proposal, ProposedTerm

FITTED = {"speed_m_s": [-0.5, 0.7]}


def proposal(terms, gone=None):
    return Proposal(
        1,
        (),
        "",
        terms,
        gone or {},
        fitted=FITTED,
        patch=file_of(1),
        former=file_of(1, "-former"),
    )


def written(folder, made, others=None):
    patches.write(folder, made, others or {}, Config().sha256)
    return [load_patch(folder / name) for name in (made.patch, made.former)]


def test_terms_say_where_they_were_fitted(tmp_path):
    made = proposal({"rotation_gain": ProposedTerm(0.03, "1", (0.02, 0.04))})
    forth, back = written(tmp_path, made)
    assert forth.model.terms["rotation_gain"].fitted_in.speed_m_s == (-0.5, 0.7)
    assert forth.values == {"terms.rotation_gain": 0.03}
    assert back.values == {"terms.rotation_gain": 0.0}


CASES = [
    ({}, {"rotation_gain": ProposedTerm(0.03, "1")}, {}),
    (
        {"rotation_gain": 0.01},
        {"rotation_gain": ProposedTerm(0.03, "1", None, 0.01)},
        {},
    ),
    (
        {"nav_latency": 0.1, "rotation_gain": 0.02},
        {},
        {"nav_latency": 0.1, "rotation_gain": 0.02},
    ),
    (
        {"nav_latency": 0.1},
        {"wheel_radius": ProposedTerm(0.01, "1")},
        {"nav_latency": 0.1},
    ),
    ({"saturation_limit": 55.0}, {}, {"saturation_limit": 55.0}),
]


@pytest.mark.parametrize("tuned", [{}, {"plant.controller.k_p": 12.0}])
@pytest.mark.parametrize(("before", "terms", "gone"), CASES)
async def test_forth_and_back_leave_all_else_as_it_was(
    tmp_path, before, terms, gone, tuned
):
    made = proposal(terms, gone)
    async with build(assemble_config(Config(), tmp_path)) as core:
        core.scheduler.step(1)
        await core.scheduler.wait_paused()
        own = Patches(tmp_path, core)
        core.parameters.apply({**{f"terms.{n}": v for n, v in before.items()}, **tuned})
        await core.scheduler.advance(5)
        start = dict(core.parameters.differing)
        written(tmp_path, made, patches.split(start)[1])
        for name in (made.patch, made.former):
            number = await lay(own, core, name)
            assert number > 0
            if name == made.patch:
                after = {n: t.value for n, t in terms.items()}
                assert patches.split(core.parameters.differing) == (after, tuned)
        assert dict(core.parameters.differing) == start


async def lay(own, core, name):
    """Load a patch while time goes on, as it does in a daemon."""
    task = asyncio.create_task(own.load(name))
    while not task.done():
        await core.scheduler.advance(1)
        await asyncio.sleep(0)
    await task
    return core.scheduler.ticks_done


def test_a_folder_that_takes_nothing_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(
        FailedError, match=r"recalibrated-0001\.yaml: cannot be written"
    ):
        written(tmp_path / "file", proposal({"rotation_gain": ProposedTerm(0.03, "1")}))
