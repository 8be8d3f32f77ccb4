"""The daemon's side: who may decide, what acts, what is written down, and what goes wrong."""

import asyncio
import json
import threading
from contextlib import asynccontextmanager
from dataclasses import replace

import pytest
from asyncua import ua

from hilserver.config.patch import load_patch
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.connections import LINKS
from hilserver.daemon.daemon import Daemon
from hilserver.errors import ControlRefused, FailedError
from hilserver.program.whole_file import write_whole
from hilserver.recalibration import link, patches, process
from hilserver.recalibration.history import FILE, broken
from hilserver.recalibration.orders import (
    JudgeOrder,
    JudgeResult,
    Looked,
    ModelsCompared,
    Todo,
)
from hilserver.recalibration.proposals import (
    ProposalStage,
    ProposalStep,
    ProposedTerm,
    Quantity,
)
from hilserver.recalibration.windows import RecalibrationWindow
from tests.io.opcua_server.rig import RobotClient
from tests.loopback.rig import configuration, scrape, wait_until

GAIN = {"yaw_rad": Quantity(0.06, 0.01, 6.0, (4.0, 8.0))}
BETTER, NO_BETTER = (
    ModelsCompared(1e-6, 1e-6, 72, GAIN),
    ModelsCompared(0.4, 1e-6, 72, GAIN),
)
NAMED = Looked(
    "named",
    "The robot turns 3 % more than its wheels say.",
    ("rotation_gain",),
    {"rotation_gain": ProposedTerm(0.03, "1", (0.02, 0.04))},
)
NUMBER = ua.VariantType.UInt32


@pytest.fixture
def answers(monkeypatch):
    """Looks answer what the test says; nothing is recorded."""
    said = []

    async def looked(order, folder, limit_s):
        return said.pop(0)

    monkeypatch.setattr(process, "looked", looked)
    monkeypatch.setattr(process, "recorder", lambda *_: ["sleep", "1000"])
    return said


@asynccontextmanager
async def daemon_in(folder, opcua=None, patch=None, **recalibration):
    """A daemon in real time whose recalibration is driven by the test."""
    sections = {
        "recalibration": {"enabled": True, "every_s": 60, "window_s": 60}
        | recalibration
    }
    if opcua is not None:
        sections["opcua"] = {"endpoint": "opc.tcp://127.0.0.1:0/hilserver"} | opcua
    laid_over = None if patch is None else load_patch(patch)
    assembly = assemble_config(configuration(**sections), folder, laid_over)
    async with Daemon(assembly, links=(*LINKS, link.parts)) as daemon:
        yield daemon, daemon.part("recalibration")


async def windows(part, answers, *results):
    """Have windows judged, one after the other."""
    for result in results:
        answers.append(result)
        number = part._news.last = part._news.last + 1
        await part._next(RecalibrationWindow(number, part._folder / "window.mcap"))
        answers.clear()


async def proposed(part, answers):
    await windows(part, answers, JudgeResult(look=NAMED), JudgeResult(confirm=BETTER))
    assert part.loop.proposal.stage is ProposalStage.OPEN


def lines(folder):
    text = (folder / "recalibration" / FILE).read_text()
    return [json.loads(line) for line in text.splitlines()]


@asynccontextmanager
async def client_of(daemon):
    client = RobotClient(daemon.part("opcua").url)
    await client.connect()
    try:
        yield client
    finally:
        await client.disconnect()


def number(value):
    return ua.Variant(value, NUMBER)


async def test_a_proposal_is_shown_accepted_and_measured(tmp_path, answers):
    async with daemon_in(tmp_path) as (daemon, part):
        await proposed(part, answers)
        async with client_of(daemon) as client:
            await wait_until(lambda: shown(client, "proposal.stage", "open"))
            assert await client.read("recalibration.proposal.causes") == "rotation_gain"
            assert await client.read("recalibration.look.verdict") == ""
            await exported(daemon, "proposal_open 1.0")
            assert (
                await client.call("AcceptProposal", number(1))
            ).StatusCode.name == "Good"
            again = await client.call("AcceptProposal", number(1))
            assert again.StatusCode.name == "BadInvalidState"
        assert daemon.core.parameters.differing == {"terms.rotation_gain": 0.03}
        assert daemon.desk.patches.loaded == "recalibrated-0001.yaml"
        assert daemon.desk.patches.notice is None
        decision = lines(tmp_path)[-1]
        assert (decision["kind"], decision["who"]) == ("decision", "anonymous engineer")
        assert decision["proposal"]["stage"] == "accepted"
        await windows(part, answers, JudgeResult(look=Looked("as_running")))
        await windows(
            part, answers, JudgeResult(measure=BETTER, look=Looked("as_running"))
        )
        assert part.loop.proposal.stage is ProposalStage.BETTER
        await exported(daemon, 'effect_ratio{quantity="yaw_rad"} 6.0')
        await exported(daemon, 'looks_total{verdict="named"} 1.0')
        assert broken(lines(tmp_path)) is None
        said = [e.message for e in daemon.events.recent if e.kind == "recalibration"]
        assert said[0] == f"proposal 1 needs a decision: {NAMED.sentence}"
        why = "was refused: proposal 1 is accepted, not open"
        assert f"AcceptProposal by anonymous engineer {why}" in said
        await exported(daemon, 'decisions_total{outcome="accepted"} 1.0')
        await exported(daemon, 'decisions_total{outcome="refused"} 1.0')


async def exported(daemon, text):
    """Wait for a line of the metrics; those of one moment are kept for the next 50 ms."""

    async def is_there():
        return f"hil_recalibration_{text}" in await scrape(daemon)

    await wait_until(is_there)


async def shown(client, name, value):
    try:
        return await client.read(f"recalibration.{name}") == value
    except ua.UaStatusCodeError:
        return False


async def test_one_that_does_not_help_is_taken_back(tmp_path, answers):
    async with daemon_in(tmp_path) as (daemon, part):
        await proposed(part, answers)
        await part.accept(1, "eve")
        nothing = Looked("as_running")
        await windows(
            part,
            answers,
            JudgeResult(look=nothing),
            JudgeResult(measure=NO_BETTER, look=nothing),
        )
        assert part.loop.proposal.number == 2
        await part.accept(2, "eve")
        assert daemon.core.parameters.differing == {}


async def test_one_that_was_reset_before_its_effect_is_measured_is_closed(
    tmp_path, answers
):
    async with daemon_in(tmp_path) as (daemon, part):
        await proposed(part, answers)
        await part.accept(1, "eve")
        async with client_of(daemon) as client:
            assert (await client.call("ResetParameters")).StatusCode.is_good()
        assert daemon.core.parameters.differing == {}
        await windows(part, answers, JudgeResult(look=Looked("nothing")))
        assert part.loop.proposal.stage is ProposalStage.REPLACED
        closed = next(line for line in lines(tmp_path) if line.get("window") == 3)
        assert (closed["kind"], closed["proposal"]["stage"]) == ("decision", "replaced")
        said = [e.message for e in daemon.events.recent if e.kind == "recalibration"]
        assert "proposal 1 is no longer active: its effect is not measured" in said


@pytest.mark.parametrize("role", ["observer", "operator"])
async def test_only_an_engineer_decides(tmp_path, answers, role):
    async with daemon_in(tmp_path, {"anonymous": role}) as (daemon, part):
        await proposed(part, answers)
        async with client_of(daemon) as client:
            for method in ("AcceptProposal", "RejectProposal", "PostponeProposal"):
                code = (await client.call(method, number(1))).StatusCode.name
                assert code == "BadUserAccessDenied"
                assert (await client.call(method, number(1))).StatusCode.name == code
            await wait_until(lambda: shown(client, "proposal.stage", "open"))
        assert daemon.core.parameters.differing == {}
        said = [e.message for e in daemon.events.recent if "was refused" in e.message]
        assert said == [  # once each, however often it is tried
            f"{method} by anonymous {role} was refused: your role does not allow this call"
            for method in ("AcceptProposal", "RejectProposal", "PostponeProposal")
        ]
        await exported(daemon, 'decisions_total{outcome="refused"} 6.0')


async def test_a_flood_of_refusals_drives_no_other_event_out(tmp_path, answers):
    async with daemon_in(tmp_path) as (daemon, part):
        for k in range(1000):
            part.refused(
                f"AcceptProposal by eve was refused: {k} is not the latest proposal"
            )
        said = [e for e in daemon.events.recent if e.kind == "recalibration"]
        assert 0 < len(said) < 50
        await exported(daemon, 'decisions_total{outcome="refused"} 1000.0')


async def test_who_decided_is_written_down(tmp_path, answers):
    async with daemon_in(tmp_path) as (_, part):
        await proposed(part, answers)
        await part.postpone(1, "ada")
        await part.reject(1, "eve")
    assert [line["who"] for line in lines(tmp_path)[-2:]] == ["ada", "eve"]


async def test_what_cannot_be_written_down_is_not_done(tmp_path, answers, monkeypatch):
    async with daemon_in(tmp_path) as (daemon, part):
        await proposed(part, answers)
        monkeypatch.setattr("hilserver.recalibration.history.os.write", lambda *_: 0)
        with pytest.raises(
            FailedError, match=r"recalibration\.jsonl: cannot be written"
        ):
            await part.accept(1, "eve")
        monkeypatch.undo()
        assert daemon.core.parameters.differing == {}
        assert part.loop.proposal.stage is ProposalStage.OPEN


@pytest.mark.parametrize(
    "damage", [lambda file: file.unlink(), lambda file: file.write_text("{")]
)
async def test_what_was_shown_acts_whatever_became_of_its_file(
    tmp_path, answers, damage
):
    async with daemon_in(tmp_path) as (daemon, part):
        await proposed(part, answers)
        damage(tmp_path / "patches" / "recalibrated-0001.yaml")
        await part.accept(1, "eve")
        assert daemon.core.parameters.differing == {"terms.rotation_gain": 0.03}


async def test_what_was_tuned_since_stays(tmp_path, answers):
    async with daemon_in(tmp_path) as (daemon, part):
        daemon.core.parameters.apply({"plant.controller.k_p": 12.0})
        await proposed(part, answers)
        daemon.core.parameters.apply({"plant.controller.k_p": 14.0})
        await part.accept(1, "eve")
        wanted = {"terms.rotation_gain": 0.03, "plant.controller.k_p": 14.0}
        assert daemon.core.parameters.differing == wanted


async def test_a_plant_that_takes_nothing_leaves_the_proposal_open(
    tmp_path, answers, monkeypatch
):
    async with daemon_in(tmp_path) as (daemon, part):
        await proposed(part, answers)
        monkeypatch.setattr(type(daemon.core.parameters), "apply", refused)
        with pytest.raises(ControlRefused, match="a snapshot is being loaded"):
            await part.accept(1, "eve")
        assert daemon.core.parameters.differing == {}
        assert part.loop.proposal.stage is ProposalStage.OPEN
        assert [line["kind"] for line in lines(tmp_path)][-2:] == ["decision", "undone"]


def refused(*args, **kwargs):
    raise ControlRefused("a snapshot is being loaded; try again")


async def test_who_leaves_before_it_acts_has_accepted(tmp_path, answers, monkeypatch):
    """The patch is handed over; a client that is gone by then does not take it back."""
    async with daemon_in(tmp_path) as (daemon, part):
        await proposed(part, answers)
        handed_over = asyncio.Event()

        async def taken(self, number):
            handed_over.set()
            await asyncio.Event().wait()

        monkeypatch.setattr(type(daemon.core.parameters), "taken", taken)
        accepting = asyncio.create_task(part.accept(1, "eve"))
        await handed_over.wait()
        accepting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await accepting
        assert daemon.core.parameters.differing == {"terms.rotation_gain": 0.03}
        assert part.loop.proposal.stage is ProposalStage.ACCEPTED
        assert lines(tmp_path)[-1]["kind"] == "decision"


async def test_of_two_at_once_one_accepts(tmp_path, answers):
    async with daemon_in(tmp_path) as (daemon, part):
        await proposed(part, answers)
        both = (part.accept(1, "ada"), part.accept(1, "eve"))
        first, second = await asyncio.gather(*both, return_exceptions=True)
        assert first is None
        assert "proposal 1 is accepted, not open" in str(second)
        decisions = [
            line["who"] for line in lines(tmp_path) if line["kind"] == "decision"
        ]
        assert decisions == ["ada"]
        assert daemon.core.parameters.differing == {"terms.rotation_gain": 0.03}


async def test_parameters_that_changed_meanwhile_are_not_undone(tmp_path, answers):
    async with daemon_in(tmp_path) as (daemon, part):
        await proposed(part, answers)
        daemon.core.parameters.apply({"terms.wheel_radius": 0.01})
        with pytest.raises(ControlRefused, match="have changed since proposal 1"):
            await part.accept(1, "eve")


@pytest.mark.parametrize(("high", "acts"), [(0.05, True), (0.02, False)])
async def test_within_ranges_it_acts_by_itself(tmp_path, answers, high, acts):
    ranges = {"rotation_gain": [-0.05, high]}
    async with daemon_in(tmp_path, accept="automatic", ranges=ranges) as (daemon, part):
        await windows(
            part, answers, JudgeResult(look=NAMED), JudgeResult(confirm=BETTER)
        )
        assert bool(daemon.core.parameters.differing) == acts
        assert part.loop.proposal.stage is (
            ProposalStage.ACCEPTED if acts else ProposalStage.OPEN
        )


async def test_what_an_engineer_has_postponed_does_not_act_by_itself(tmp_path, answers):
    ranges = {"rotation_gain": [-0.05, 0.05]}
    async with daemon_in(tmp_path, accept="automatic", ranges=ranges) as (daemon, part):
        await windows(part, answers, JudgeResult(look=NAMED))
        part._config = part._config.model_copy(update={"accept": "engineer"})
        await windows(part, answers, JudgeResult(confirm=BETTER))
        await part.postpone(1, "eve")
        part._config = part._config.model_copy(update={"accept": "automatic"})
        await windows(part, answers, JudgeResult(look=Looked("nothing")))
        assert part.loop.proposal.stage is ProposalStage.POSTPONED
        assert daemon.core.parameters.differing == {}


async def test_a_kill_between_decision_and_patch_leaves_the_proposal_open(
    tmp_path, answers
):
    """The line of the decision is on disk, and nothing of the patch has acted."""
    async with daemon_in(tmp_path) as (_, part):
        await proposed(part, answers)
        decided = part.loop.decided(ProposalStep.ACCEPT, 1)
        part._history.append("decision", who="eve", proposal=decided.as_json())
    async with daemon_in(tmp_path) as (daemon, part):
        assert part.loop.proposal.stage is ProposalStage.OPEN
        assert daemon.core.parameters.differing == {}
        await part.accept(1, "eve")
        assert daemon.core.parameters.differing == {"terms.rotation_gain": 0.03}


async def test_a_proposal_waits_for_the_next_run(tmp_path, answers):
    async with daemon_in(tmp_path) as (_, part):
        await proposed(part, answers)
        before = part.loop.proposal
        damaged = part._patches / before.patch
        damaged.write_text("{")  # by whom ever; what was shown is in the history
    async with daemon_in(tmp_path) as (daemon, part):
        assert part.loop.proposal.number == before.number
        await part.accept(1, "eve")
        assert daemon.core.parameters.differing == {"terms.rotation_gain": 0.03}


async def test_a_look_that_a_kill_cut_short_is_named_by_the_next_run(tmp_path, answers):
    async with daemon_in(tmp_path) as (_, part):
        await proposed(part, answers)
    todo = Todo(9, {}, look=True)
    order = JudgeOrder(todo, "/window_0009.mcap", {}, "/", {}, "").text()
    (tmp_path / "recalibration" / process.ORDER).write_text(order)
    async with daemon_in(tmp_path) as (daemon, part):
        said = [e.message for e in daemon.events.recent if e.kind == "recalibration"]
        assert said == [
            "window 9 could not be diagnosed: the daemon was killed during its look; nothing from"
            " it was applied"
        ]
        assert daemon.core.parameters.differing == {}
        assert part.loop.proposal.stage is ProposalStage.OPEN
    last = lines(tmp_path)[-1]
    assert (last["kind"], last["window"]) == ("failed", 9)
    assert broken(lines(tmp_path)) is None


async def test_a_disk_that_takes_no_patch_leaves_nothing_to_accept(tmp_path, answers):
    (tmp_path / "patches").write_text("")  # no folder can be made in its place
    async with daemon_in(tmp_path) as (daemon, part):
        await proposed(part, answers)
        said = [e.message for e in daemon.events.recent if e.kind == "recalibration"]
        assert any("recalibrated-0001.yaml: cannot be written" in text for text in said)
        with pytest.raises(
            FailedError, match=r"recalibrated-0001\.yaml: cannot be written"
        ):
            await part.accept(1, "eve")
        assert daemon.core.parameters.differing == {}
        assert part.loop.proposal.stage is ProposalStage.OPEN
        assert lines(tmp_path)[-1]["kind"] == "proposal"


@asynccontextmanager
async def slow_disk(monkeypatch):
    """Patches get to the disk only when the block ends; each one that waits sets the event."""
    waits, may_go, loop = asyncio.Event(), threading.Event(), asyncio.get_running_loop()

    def written(path, content):
        loop.call_soon_threadsafe(waits.set)
        assert may_go.wait(60.0), "the event loop waits for the disk"
        write_whole(path, content)

    monkeypatch.setattr(patches, "write_whole", written)
    try:
        yield waits
    finally:
        may_go.set()
        monkeypatch.setattr(patches, "write_whole", write_whole)


async def test_a_proposal_does_not_wait_for_the_disk_on_the_event_loop(
    tmp_path, answers, monkeypatch
):
    async with daemon_in(tmp_path) as (daemon, part):
        async with slow_disk(monkeypatch) as waits:
            proposing = asyncio.create_task(proposed(part, answers))
            await waits.wait()
        await proposing
        async with slow_disk(monkeypatch) as waits:
            accepting = asyncio.create_task(part.accept(1, "eve"))
            await waits.wait()
        await accepting
        assert daemon.core.parameters.differing == {"terms.rotation_gain": 0.03}


async def test_what_is_tuned_while_the_patch_is_written_stays(
    tmp_path, answers, monkeypatch
):
    async with daemon_in(tmp_path) as (daemon, part):
        daemon.core.parameters.apply({"plant.controller.k_p": 12.0})
        await proposed(part, answers)
        async with slow_disk(monkeypatch) as waits:
            accepting = asyncio.create_task(part.accept(1, "eve"))
            await waits.wait()
            daemon.core.parameters.apply({"plant.controller.k_p": 14.0})
        with pytest.raises(
            ControlRefused, match="changed while the patch of proposal 1"
        ):
            await accepting
        assert daemon.core.parameters.differing == {"plant.controller.k_p": 14.0}
        await part.accept(1, "eve")
        wanted = {"terms.rotation_gain": 0.03, "plant.controller.k_p": 14.0}
        assert daemon.core.parameters.differing == wanted


async def test_who_leaves_while_the_patch_is_written_has_not_accepted(
    tmp_path, answers, monkeypatch
):
    """Nobody else has the turn until the thread has ended."""
    async with daemon_in(tmp_path) as (_, part):
        await proposed(part, answers)
        async with slow_disk(monkeypatch) as waits:
            accepting = asyncio.create_task(part.accept(1, "eve"))
            await waits.wait()
            accepting.cancel()
            await asyncio.sleep(0.05)
            assert part._turn.locked()
        with pytest.raises(asyncio.CancelledError):
            await accepting
        assert part.loop.proposal.stage is ProposalStage.OPEN
        await part.accept(1, "eve")
        assert part.loop.proposal.stage is ProposalStage.ACCEPTED


async def test_who_starts_with_what_was_accepted_has_it_measured(tmp_path, answers):
    async with daemon_in(tmp_path) as (_, part):
        await proposed(part, answers)
        await part.accept(1, "eve")
    patch = tmp_path / "patches" / "recalibrated-0001.yaml"
    async with daemon_in(tmp_path, patch=patch) as (_, part):
        assert part.loop.proposal.stage is ProposalStage.ACCEPTED
        await windows(
            part, answers, JudgeResult(measure=BETTER, look=Looked("as_running"))
        )
        assert part.loop.proposal.stage is ProposalStage.BETTER


async def test_a_number_that_is_none_is_an_event(tmp_path, answers):
    endless = replace(BETTER, gain={"yaw_rad": Quantity(0.06, 0.0, float("inf"))})
    async with daemon_in(tmp_path) as (daemon, part):
        await windows(
            part, answers, JudgeResult(look=NAMED), JudgeResult(confirm=endless)
        )
        said = [e.message for e in daemon.events.recent if e.kind == "recalibration"]
        assert any(
            "a proposal contains a number that is not finite" in text for text in said
        )
        with pytest.raises(FailedError, match="not finite"):
            await part.accept(1, "eve")
        assert daemon.core.parameters.differing == {}


@pytest.mark.parametrize("line", ["nonsense", '{"p": NaN}', '{"p": ' + "[" * 100_000])
async def test_a_damaged_history_is_one_sentence(tmp_path, answers, line):
    folder = tmp_path / "recalibration"
    folder.mkdir()
    (folder / FILE).write_text(f"{{}}\n{line}\n{{}}\n")
    with pytest.raises(FailedError, match="line 2 is damaged"):
        async with daemon_in(tmp_path):
            pass


async def test_a_history_that_somebody_changed_is_an_event(tmp_path, answers):
    async with daemon_in(tmp_path) as (_, part):
        await proposed(part, answers)
    file = tmp_path / "recalibration" / FILE
    file.write_text(file.read_text().replace('"value": 0.03', '"value": 0.3'))
    async with daemon_in(tmp_path) as (daemon, part):
        said = [e.message for e in daemon.events.recent if e.kind == "recalibration"]
        assert any(
            "line 3 does not follow from those before it" in text for text in said
        )
        assert part.loop.proposal is None  # nobody can accept what was not proposed


async def test_a_recorder_that_ends_is_an_event(tmp_path, answers, monkeypatch):
    words = ["sh", "-c", "echo 'hilserver: no space is left' >&2; exit 1"]
    monkeypatch.setattr(process, "recorder", lambda *_: words)
    async with daemon_in(tmp_path) as (daemon, part):
        await wait_until(lambda: part.figures.failures > 0)
        said = [e.message for e in daemon.events.recent if e.kind == "recalibration"]
        assert said == ["windows are not being recorded: no space is left"]


async def test_without_recalibration_the_methods_say_so(tmp_path):
    async with Daemon(assemble_config(configuration(), tmp_path)) as daemon:
        async with client_of(daemon) as client:
            code = (await client.call("AcceptProposal", number(1))).StatusCode.name
        assert code == "BadInvalidState"
        assert daemon.part("recalibration") is None


async def test_the_loop_takes_a_gap_that_grew(tmp_path, answers):
    async with daemon_in(tmp_path) as (daemon, part):
        part._gap.take = lambda _: "wheel.fl.speed_rpm"
        await wait_until(lambda: part.loop.changed == "wheel.fl.speed_rpm")
        await exported(daemon, "gap_changed 1.0")
