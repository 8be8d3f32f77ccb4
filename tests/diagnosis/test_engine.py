"""What holds for every diagnosis, whatever it finds."""

from dataclasses import replace

from hilserver_injector import Recipe, make
from threadpoolctl import threadpool_info, threadpool_limits

from benchmarks.diagnose_worker import measured
from hilserver.daemon.assembly import assemble
from hilserver.diagnosis import engine
from hilserver.diagnosis.checks.support import data_fault
from hilserver.diagnosis.engine import diagnose
from hilserver.diagnosis.findings.nested import answers_of
from hilserver.diagnosis.findings.worth import Explained
from hilserver.diagnosis.schema.findings import Gain, Verdict


def blas_threads():
    return {
        pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"
    }


def test_linear_algebra_keeps_to_one_thread_and_gives_the_others_back():
    """Its products are small: a second thread only waits, and takes the CPU of others."""
    recipe, seen = Recipe(seed=1, duration_s=20.0), set()
    with threadpool_limits(2, "blas"):
        before = blas_threads()
        diagnose(
            measured(make(recipe)[0]),
            assemble(None),
            progress=lambda text, share: seen.update(blas_threads()),
        )
        assert seen == {1}
        assert blas_threads() == before


class Worse(Explained):
    """What is reported makes the yaw worse, whatever it is made of."""

    def gains(self, horizon_s, rng, before=None):
        gain = Gain(
            horizon_s=horizon_s, before=1.0, after=2.0, ratio=0.5, ci95=(0.4, 0.6)
        )
        return {"yaw_rad": gain}


def test_no_patch_is_written_where_a_reported_quantity_is_worse(monkeypatch):
    """What is reported is the patch; what else predicts is nobody's."""
    recipe = Recipe(seed=1, causes={"rotation_gain": -0.3}, duration_s=20.0)
    log, assembly = measured(make(recipe)[0]), assemble(None)
    assert diagnose(log, assembly, jobs=1).evidence.extension

    def worse(*args):
        return [
            replace(a, patch=Worse(a.patch.parts, a.patch.without))
            for a in answers_of(*args)
        ]

    monkeypatch.setattr(engine, "answers_of", worse)
    found = diagnose(log, assembly, jobs=1)
    assert not found.evidence.extension
    assert any("no model patch" in note for note in found.findings.notices)


def test_a_fault_of_both_sets_is_said_once_and_of_which():
    fault, other = (
        data_fault(name, ["nav.x_m"], 1.0, None, "1", f"{name}.") for name in "ab"
    )
    both = engine._of_both([fault], [fault, other])
    assert sorted(f.explanation for f in both) == [
        "In both sets: a.",
        "In the second set: b.",
    ]
    (first,) = engine._of_both([other], [])
    assert first.explanation == "In the first set: b."


def turning(gain, seed):
    causes = {"rotation_gain": gain}
    return measured(make(Recipe(seed=seed, causes=causes, duration_s=45.0))[0])


def test_a_name_needs_the_other_logs_if_there_are_any():
    """Half of an effect: the error with the whole one is as large as that without any."""
    log, assembly = turning(-0.2, 1), assemble(None)
    alike, other = (
        diagnose(log, assembly, jobs=1, test=turning(gain, 2)) for gain in (-0.2, -0.1)
    )
    assert [f.verdict for f in alike.findings.findings] == [Verdict.NAMED]
    assert [f.verdict for f in other.findings.findings] == [Verdict.EFFECTIVE]
    (finding,) = other.findings.findings
    assert finding.parameters == alike.findings.findings[0].parameters
    assert "these data do not tell" in finding.explanation
    assert any("no error is clearly smaller" in n for n in other.findings.notices)
    assert not any("no error is clearly" in n for n in alike.findings.notices)
