"""Tests that are written wrongly: none of them passes without having run."""

import textwrap

import pytest

from tests.testing.test_plugin import LOAD

OWN_FIXTURE = """
    import pytest

    @pytest.fixture
    def robot(hil):
        return hil
"""
NEVER_RUN_BY_OTHERS = {
    "generator on a fixture of one's own": (
        OWN_FIXTURE,
        "async def test_it(robot): yield 5; assert 0",
    ),
    "coroutine on a fixture of one's own": (
        OWN_FIXTURE,
        "async def test_it(robot): assert 0",
    ),
    "generator that names hil by a mark": (
        "import pytest",
        "@pytest.mark.usefixtures('hil')\nasync def test_it(): yield 5; assert 0",
    ),
    "method of a class that names hil by a mark": (
        "import pytest",
        "@pytest.mark.usefixtures('hil')\nclass TestT:\n async def test_it(_):\n  yield; assert 0",
    ),
    "parametrized generator": (
        OWN_FIXTURE,
        "@pytest.mark.parametrize('n', [1])\nasync def test_it(robot, n): yield n; assert 0",
    ),
}


@pytest.fixture(params=["strict", "auto"])
def outcomes(request, pytester):
    """Run a file of tests in one of the modes of pytest-asyncio; return counts and text."""

    def run(head, test, *options):
        pytester.makeini("[pytest]\nasyncio_default_fixture_loop_scope = function\n")
        pytester.makepyfile(f"{textwrap.dedent(head)}\n{textwrap.dedent(test)}\n")
        mode = "-o", f"asyncio_mode={request.param}"
        result = pytester.runpytest_inprocess(
            *LOAD, "-p", "no:cacheprovider", *mode, *options
        )
        return result.parseoutcomes(), result.stdout.str(), result.ret

    return run


@pytest.mark.parametrize("kind", NEVER_RUN_BY_OTHERS)
def test_whatever_brings_hil_its_body_runs(outcomes, kind):
    assert outcomes(*NEVER_RUN_BY_OTHERS[kind])[0] == {"failed": 1}


def test_a_right_test_on_a_fixture_of_ones_own_passes(outcomes):
    test = (
        "async def test_it(robot):\n"
        "    now_s = yield 5\n"
        "    assert robot.tick == 6 and now_s > 0"
    )
    assert outcomes(OWN_FIXTURE, test)[0] == {"passed": 1}


@pytest.mark.parametrize(
    ("test", "sentence"),
    [
        ("async def test_it(hil): hil.step(5)", "write 'await hil.step(...)'"),
        ("def test_it(hil): hil.run_for(5)", "write 'await hil.run_for(...)'"),
        (
            "async def test_it(hil):\n yield 5\n hil.wait_for('sim.tick', bool)",
            "hil.wait_for was",
        ),
    ],
)
def test_a_forgotten_await_fails(outcomes, test, sentence):
    counts, said, _ = outcomes("", test)
    assert counts == {"failed": 1}
    assert sentence in said


def test_a_generator_that_is_not_asynchronous_does_not_pass(outcomes):
    counts, said, code = outcomes("", "def test_it(hil):\n    yield 5")
    assert (counts, code != 0) == ({"errors": 1}, True)
    assert "yield" in said


@pytest.mark.parametrize(
    ("head", "test", "options", "remedy"),
    [
        (
            "",
            "async def test_it(hil): pass",
            ("-p", "no:asyncio"),
            "do not start pytest",
        ),
        (
            "import pytest, unittest",
            "@pytest.mark.usefixtures('hil')\nclass TestIt(unittest.TestCase):\n"
            " async def test_it(self): assert 0",
            (),
            "not in a unittest.TestCase",
        ),
    ],
)
def test_what_cannot_run_fails_with_the_remedy(outcomes, head, test, options, remedy):
    counts, said, code = outcomes(head, test, *options)
    assert (counts["errors"], counts.get("passed"), code != 0) == (1, None, True)
    assert remedy in said


@pytest.mark.parametrize(
    "judged",
    [
        "trace.assert_meets(dict(name='n', signal='pose.x_m', below=9, always=True, within_s=4))",
        "trace.assert_meets(dict(name='n', signal='pose.x_m', below=9, after_s=4))",
        "trace.assert_meets(dict(name='n', signal='pose.x_m', below=9, for_s=4))",
        "trace['pose.x_m'].assert_within(high=9, to_s=4)",
        "trace['pose.x_m'].assert_near(0, 9, to_s=4)",
        "trace['pose.x_m'].assert_settles(0, 9, within_s=4)",
    ],
)
def test_what_was_not_captured_is_not_judged(outcomes, judged):
    test = (
        "async def test_it(hil):\n"
        " async with hil.capture('pose.x_m') as trace: yield 5\n"
        f" {judged}"
    )
    counts, said, _ = outcomes("", test)
    assert counts == {"failed": 1}
    assert "step further inside the capture" in said
