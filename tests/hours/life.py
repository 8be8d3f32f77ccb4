"""Some seconds in the life of the town: users, faults, then peace, and what the judges say."""

import asyncio
import hashlib
import shutil
import time
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from random import Random

import numpy as np

from hilserver.errors import FailedError
from hilserver.io.recorder.recorder import Recorder
from hilserver.signals import State
from hilserver.tasks import end
from tests.hours import clock
from tests.hours.disk import TROUBLES, Disk, put_under
from tests.hours.judges import Judges
from tests.hours.ledger import Ledger
from tests.hours.loop import NS, run_in
from tests.hours.recording import damaged, difference, recorder_of
from tests.hours.town import Town
from tests.hours.users import LOST, Browser, Controller, Program, Terminal
from tests.hours.watchers import Engineer, Panel, Stranger, Watcher

LOOK_S = 1.0
RECORDED_EVERY = 5  # seeds
SNAPSHOTS, RECORDING = "snapshots", "drive.mcap"
PEACE_S = 5.0  # within so long after the last fault everything is good again
STALLS_S = (0.005, 0.05, 0.3, 0.8)
HOLDS_S = (0.05, 0.4)
KINDS = {
    "program": Program, "terminal": Terminal, "browser": Browser, "engineer": Engineer,
    "stranger": Stranger, "panel": Panel, "watcher": Watcher,
}  # fmt: skip
DRAWN = [kind for kind in KINDS if kind != "watcher"]


@dataclass
class Result:
    """What became of a seed."""

    seed: int
    found: list[str] = field(default_factory=list)
    simulated_s: float = 0.0
    cpu_s: float = 0.0
    figures: dict[str, int] = field(default_factory=dict)
    digest: str = ""
    parts: list[str] = field(default_factory=list)


class Life:
    """One seed in one town."""

    def __init__(
        self, town: Town, seed: int, seconds: float, without: Collection[str] = ()
    ) -> None:
        clock.seed(seed)
        town.loop.chance.seed(seed)
        town.seed = seed
        self.town, self.seed, self.seconds = town, seed, seconds
        self._without, self.parts = without, list[str]()
        folder, after = (town.folder / f"{name} {seed}" for name in ("seed", "after"))
        for left in (folder, after):  # by another mutant's life of this seed
            shutil.rmtree(left, ignore_errors=True)
        folder.mkdir()
        self.disk = Disk(folder, after, town.chance_of("disk"))
        self.recorder: Recorder | None = None
        self.disk.on_power_loss = self._note_safe
        self._safe = 0  # frames of the recording that survive the loss of power
        self._saved: set[str] = set()  # snapshots that do
        put_under(self.disk)
        town.daemon.core.snapshots._folder = folder / SNAPSHOTS
        self.ledger = Ledger()
        self.judges = Judges(town, self.ledger)
        self.controller = Controller(town, self.ledger)
        chance = town.chance_of("users")
        kinds = chance.choices(DRAWN, k=chance.randint(2, 5))
        names = [f"{kind} {number}" for number, kind in enumerate(kinds)]
        self.users = [
            KINDS[name.partition(" ")[0]](name, town, self.ledger)
            for name in [*names, "watcher"]
            if self._takes_part(name)
        ]
        self.judges.hands = {user.name for user in self.users if user.is_hand}
        if seed % RECORDED_EVERY == 0:
            town.is_recorded = True
            self.recorder = recorder_of(town.image, folder / RECORDING)
        self._digest = hashlib.sha256()
        self.begun_s, self._until_found = town.loop.time(), False

    def _takes_part(self, name: str) -> bool:
        """Note that there is such a part of this life; whether it is not left out."""
        self.parts.append(name)
        return name not in self._without

    def run(self, *, until_found: bool = False) -> Result:
        """Live, and judge; to the first breach only, if nothing else is asked for."""
        self._until_found = until_found
        began_s, from_ns = time.process_time(), self.town.loop.clock.now_ns
        result = Result(self.seed)
        try:
            run_in(self.town.loop, self._run())
        except Exception as error:
            self.judges.found.append(f"{type(error).__name__}: {error}")
            if not isinstance(error, AssertionError | TimeoutError):
                raise
        self._judge_files()
        result.found = self.judges.found
        result.simulated_s = (self.town.loop.clock.now_ns - from_ns) / NS
        result.cpu_s = time.process_time() - began_s
        result.figures = {
            "ticks": self.judges.ticks, "moving": self.judges.moving, "steady": self.judges.steady,
            "acts": len(self.ledger.acts), "came": sum(user.came for user in self.users),
            "turns": self.town.loop.turns, "lost power": self.disk.after.exists(),
        }  # fmt: skip
        result.parts = self.parts
        result.digest = self._digest.hexdigest()[:16]
        return result

    def _judge_files(self) -> None:
        """Every file is whole or not there, now and after a loss of power."""
        found, disk = self.judges.found, self.disk
        disk.trouble = ""
        if self.recorder is not None:
            try:
                self.recorder.close()
            except FailedError as error:
                if not disk.was_in_trouble:
                    found.append(str(error))
        # On a full disk even a first chunk may have been given up for the index.
        has_failed = self.recorder is not None and self.recorder._writing.error
        least = 0 if has_failed else 1
        for folder, safe in ((disk.folder, least), (disk.after, self._safe)):
            found += damaged(folder / SNAPSHOTS)
            recording = folder / RECORDING
            if not recording.exists():
                continue
            lost_power = folder == disk.after
            if where := difference(recording, safe, lost_power=lost_power):
                found.append(f"the replay of {recording} differs: {where}")
        kept = {path.name for path in (disk.after / SNAPSHOTS).glob("*.npz")}
        gone = sorted(self._saved - kept)
        found += [f"{name} was saved, and lost with the power" for name in gone]
        found += [f"{path} is left" for path in disk.folder.rglob("*.part")]

    def _note_safe(self) -> None:
        self._saved = {
            f"{act.argument}.npz"
            for act in self.ledger.acts
            if act.name == "SaveSnapshot" and act.is_accepted
        }
        if self.recorder is not None:
            self._safe = self.recorder._writing.safe

    def story(self) -> Iterator[str]:
        """Yield what the daemon said, and what users did: when, and when that came and was read."""

        def at(ns: int | None) -> str:
            return "-" if ns is None else f"{ns / NS - self.begun_s:.3f}"

        for at_s, line in self.town.lines:
            yield f"{at_s - self.begun_s:.3f} {line}"
        for act in self.ledger.acts:
            where = (at(act.mark.came_ns), at(act.mark.read_ns)) if act.mark else ()
            said = f"{act.user}: {act.name} {act.is_accepted} {act.refusal}"
            yield f"{at(act.sent_ns)} {said} {where} {at(act.done_ns)}"
        for speed in self.ledger.speeds.values():
            said = [at(mark.came_ns) for mark in speed.said] or [
                at(t) for t in speed.said_ns[::9]
            ]
            yield f"{speed.user} {speed.rpm:.3f}: {' '.join(said)}"
        for user, marks in self.ledger.neutral.items():
            yield f"{user} 0: {' '.join(at(mark.came_ns) for mark in marks)}"

    async def _run(self) -> None:
        town, judges = self.town, self.judges
        town.on_heard = self._heard
        town.daemon.events.subscribe(self._passed)
        works = [self.controller.offer(), self._note_pauses()]
        works += [user.live() for user in self.users]
        for name, part in FAULTS.items():
            if self._takes_part(name):
                works.append(part(self))
        tasks = [asyncio.ensure_future(work) for work in works]
        looking = asyncio.ensure_future(self._look_on())
        until_s = town.loop.time() + self.seconds - PEACE_S
        while town.loop.time() < until_s:
            await asyncio.sleep(LOOK_S)
            if judges.found and self._until_found:
                return
            for task in (looking, *tasks):
                if task.done() and not task.cancelled():
                    task.result()
        await self._peace(tasks)
        await end(looking)
        self._look()
        judges.look_at_limits()

    async def _look_on(self) -> None:
        while True:
            await asyncio.sleep(LOOK_S)
            self._look()

    def _look(self) -> None:
        if self.recorder is not None:
            self.recorder.look()
        self.judges.look()
        for user in self.users:
            for sentence in user.found:
                self.judges.breach(self.town.loop.clock.now_ns, sentence)
            user.found.clear()
        frame = self.town.reader.latest()
        self._digest.update(frame.values.tobytes() + frame.status.tobytes())
        loop = self.town.loop
        self._digest.update(repr((loop.turns, loop.clock.now_ns, frame.tick)).encode())
        self.judges.look_at_limits()

    def _heard(self, user: str) -> None:
        self.judges.heard_ns.setdefault(user, []).append(self.town.loop.clock.now_ns)

    def _passed(self, event: object) -> None:
        words = event.message.split("'")
        if words[0] == "control passes from ":
            self.judges.owners.append((event.monotonic_ns, words[1], words[3]))

    async def _note_pauses(self) -> None:
        while True:
            if self.town.daemon.scheduler.paused:
                self.town.stood_ns = self.town.loop.clock.now_ns
            await asyncio.sleep(0.02)

    async def _trouble(self) -> None:
        """Let the loop stand still, and the network be slow."""
        chance = self.town.chance_of("stalls")
        while True:
            await asyncio.sleep(chance.uniform(0.1, 2.0))
            if chance.random() < 0.5:
                self.town.stand_still(chance.choice(STALLS_S))
            elif chance.random() < 0.5:
                await self._stand_still_over_a_limit(chance)
            else:
                self.town.hold(chance.choice(HOLDS_S))

    async def _disk_trouble(self) -> None:
        """Let the disk be full or broken for a while."""
        chance = self.town.chance_of("disk trouble")
        while True:
            await asyncio.sleep(chance.uniform(1.0, 15.0))
            self.disk.trouble = chance.choice(TROUBLES)
            await asyncio.sleep(chance.uniform(0.5, 3.0))
            self.disk.trouble = ""

    async def _stand_still_over_a_limit(self, chance: Random) -> None:
        """Stand still while somebody's time is up, so that the answer may come in the same turn."""
        loop = self.town.loop
        limits = loop.limits()
        if not limits:
            return
        when_s = chance.choice(chance.choice(list(limits.values())))
        await asyncio.sleep(max(when_s - loop.time() - 0.01, 0.0))
        self.town.stand_still(chance.uniform(0.02, 0.6))

    # --- peace ------------------------------------------------------------------------------------

    async def _peace(self, tasks: list[asyncio.Task]) -> None:
        """End all faults: soon every link is good, and whoever comes can drive and stop."""
        town, judges = self.town, self.judges
        offering, *others = tasks
        for user in self.users:
            user.is_over = True  # the client library swallows some cancellations
        await end(*others)
        for old in self.users:
            await old.go()
        for transport in tuple(town.network.open):
            town.network.thaw(transport)
        self.controller.is_silent = False
        begun_s = town.loop.time()
        self.controller.change()
        # outranks all that may still be there
        user = Browser("the last", town, self.ledger)
        panel = Panel("the last panel", town, self.ledger)
        speed = self.controller.speed
        while town.loop.time() < begun_s + PEACE_S:
            try:
                for each in (user, panel):
                    if not each.came:
                        await each.come()
                state = int(town.frame("sim.state"))
                if state == State.SAFE:
                    await user.act("Reset")
                elif state == State.PAUSED or town.frame("control.waits_for_start"):
                    # Whoever vanished while driving may still be in control.
                    await user.write({"control.source": "page"})
                    await user.act("Start")
                elif town.daemon.gate.owner != "peer":
                    await user.write({"control.source": "page"})
                    await user.write({"control.source": "peer"})
            except (*LOST, AttributeError):
                await asyncio.sleep(0.2)
            await asyncio.sleep(0.3)
            are_in = user.came and panel.came
            if are_in and self._moves_at(speed.rpm) and not town.not_good():
                break
        else:
            for each in (user, panel):
                if not each.came:
                    what = f"{each.name} does not get in"
                    judges.found.append(f"{PEACE_S:g} s after the last fault {what}")
                    return
            state = (
                f"{town.daemon.gate.owner} has control, {town.daemon.control.reason}"
            )
            judges.found += [
                f"{PEACE_S:g} s after the last fault: {what}"
                for what in town.not_good()
            ] or [
                f"{PEACE_S:g} s after the last fault the controller does not drive: {state}"
            ]
            return
        await user.act("Stop")
        await asyncio.sleep(0.4)
        judges.look()
        stop = self.ledger.acts[-1]
        if not stop.is_accepted:
            judges.found.append("in peace, Stop is not accepted")
        await end(offering)
        await panel.do_look()
        judges.found += panel.found
        await panel.go()
        await user.go()

    def _moves_at(self, rpm: float) -> bool:
        return bool(np.isclose(self.town.frame("wheel.fl.setpoint_rpm"), rpm))


FAULTS = {
    "controller": lambda life: life.controller.live(),
    "stalls": Life._trouble,
    "disk trouble": Life._disk_trouble,
}
"""What can go wrong without a user, by its name."""
