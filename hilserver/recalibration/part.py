"""The daemon's side: watches the gap, starts looks, and carries out the engineer's decisions."""

import asyncio
import contextlib
import os
import time
from dataclasses import replace
from functools import partial
from typing import Any, Final

import structlog

from hilserver.config.root import without_passwords
from hilserver.core.events import Event, EventKind
from hilserver.core.recalibration import RECALIBRATION_METRICS, Figures, Table
from hilserver.errors import ControlRefused, FailedError, UserError
from hilserver.image import Frame
from hilserver.io.world import Figure, Part, World
from hilserver.metrics import MetricSource
from hilserver.recalibration import patches, process
from hilserver.recalibration.gap import ChangeWatch
from hilserver.recalibration.history import History, broken, is_sound
from hilserver.recalibration.loop import Note, RecalibrationLoop, present
from hilserver.recalibration.orders import JudgeOrder, Share, Todo, Values
from hilserver.recalibration.proposals import Proposal, ProposalStage, ProposalStep
from hilserver.recalibration.spending import Spending
from hilserver.recalibration.windows import RecalibrationWindow, WindowNews
from hilserver.tasks import SupervisedTask

LOOK_FOR_WINDOWS_S: Final = 1.0
# after the recorder has ended: a full disk is not freed at once
RECORD_AGAIN_S: Final = 60.0
AUTOMATIC: Final = "automatic"
KEPT_REPORTS: Final = 20
MOST_TEXT: Final = 500
REPEATED_S: Final = 10.0  # a refusal repeated sooner is only counted
MOST_REFUSALS: Final = 20  # different ones announced in that time

_log = structlog.get_logger(__name__)


class Recalibration(Part):
    """Keeps the model in step with its robot.

    All but `start`, `stop` and the decisions is synchronous, in the thread of the event loop;
    recording windows and judging them is the work of other processes.
    """

    section = label = "recalibration"

    def __init__(self, world: World) -> None:
        self._world = world
        self._config = world.config.recalibration
        self._folder = world.folder / self._config.folder
        self._patches = world.folder / world.config.folders.patches
        self._gap = ChangeWatch(world)
        self._jobs: list[SupervisedTask] = []
        self._turn = asyncio.Lock()
        self.figures = Figures()
        self.metrics = (MetricSource(RECALIBRATION_METRICS, self._counted),)
        self._last = {"kind": "", "verdict": "", "sentence": ""}
        self._refusals: dict[str, float] = {}
        self._frame: Frame | None = None
        world.files.recalibration = self

    @property
    def address(self) -> str:
        """Folder of the windows and the history."""
        return str(self._folder)

    async def start(self) -> None:
        """Read the history; start recording and judging.

        Raises
        ------
        FailedError
            If the history is damaged, or the folder cannot be created.
        """
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FailedError(
                f"{self._folder}: {(error.strerror or str(error)).lower()}"
            ) from None
        self._history = History(self._folder)
        self._news = WindowNews(self._folder)
        config = self._config
        begun_s = self._news.last * config.window_s
        self.loop = RecalibrationLoop(
            config.every_s, Spending(config.false_per_year), begun_s
        )
        sound = filter(is_sound, self._history.lines)
        self.loop.restore(sound, patches.split(self._differing)[0], self._news.last)
        if (line := broken(self._history.lines)) is not None:
            self._failed(f"{self._history.path}: line {line} does not follow from those before it:"
                         " lines are missing, or it was changed; it is ignored")  # fmt: skip
        self._history.lines.clear()
        if (window := process.cut_short(self._folder)) is not None:
            why = "the daemon was killed during its look"
            text = f"window {window} could not be diagnosed: {why}; nothing from it was applied"
            self._note(Note("failed", {"window": window, "error": why}, text, 500))
        tasks = self._world.tasks
        self._jobs = [
            tasks.keep("recalibration: windows", self._record),
            tasks.keep("recalibration: looks", self._look),
        ]

    async def stop(self) -> None:
        """End the recorder and a running look."""
        for job in self._jobs:
            await job.end()

    # --- windows ----------------------------------------------------------------------------------

    async def _record(self) -> None:
        config = self._config
        image = self._world.image.name
        command = process.recorder(image, self._folder, config.window_s, config.max_mb)
        while True:
            try:
                why = await process.recorded(command)
            except FailedError as error:
                why = str(error)
            self._failed(f"windows are not being recorded: {why}")
            await asyncio.sleep(RECORD_AGAIN_S)

    async def _look(self) -> None:
        while True:
            await asyncio.sleep(LOOK_FOR_WINDOWS_S)
            window = self._news.next()
            if window is None:
                continue
            await self._next(window)

    async def _next(self, window: RecalibrationWindow) -> None:
        """Judge a complete window if one is due."""
        now_s = window.number * self._config.window_s
        async with self._turn:
            loaded, _ = patches.split(self._differing)
            for note in self.loop.overtaken(loaded):
                self._note(note, window=window.number)
            todo = self.loop.todo(window.number, loaded, now_s)
        if todo is not None:
            await self._judge(window, todo, now_s)

    async def _judge(
        self, window: RecalibrationWindow, todo: Todo, now_s: float
    ) -> None:
        sha256 = await asyncio.to_thread(lambda: window.sha256)
        world = self._world
        config = self._config
        _, others = patches.split(self._differing)
        cores = process.other_cores(world.pacing_thread(), config.cpu)
        memory = round(config.memory_mb * 1e6)
        order = JudgeOrder(
            todo,
            str(window.path),
            without_passwords(world.config),
            str(world.folder),
            others,
            str(self._folder / f"report_{window.number % KEPT_REPORTS:02d}"),
            Share(config.nice, cores, memory, os.getpid()),
        )
        limit_s = self._config.limit
        self.figures.is_looking = True
        try:
            result = await process.looked(order, self._folder, limit_s)
        finally:
            self.figures.is_looking = False
        async with self._turn:
            before = self.loop.proposal
            for note in self.loop.take(todo, result, now_s):
                self._note(note, window=window.number, sha256=sha256)
            made = self.loop.proposal
            if (
                made is not None
                and made is not before
                and made.stage is ProposalStage.OPEN
            ):
                await self._offer(made, order.report)
        if (
            made is not None
            and made.stage is ProposalStage.OPEN
            and self._config.accept == "automatic"
            and made.within(self._config.ranges)
        ):
            try:
                await self.accept(made.number, AUTOMATIC)
            except UserError as error:
                self._failed(f"proposal {made.number} was not accepted: {error}")

    async def _offer(self, proposal: Proposal, report: str) -> None:
        """Write the files of a proposal, without which it cannot be accepted."""
        _, others = patches.split(self._differing)
        self.loop.proposal = replace(proposal, report=report)
        try:
            await self._write(proposal, others)
        except FailedError as error:
            self._failed(str(error))

    async def _write(self, proposal: Proposal, others: Values) -> None:
        """Write the files of a proposal in a thread: the event loop does not wait for the disk."""
        sha256 = self._world.files.patches.config_sha256
        loop = asyncio.get_running_loop()
        work = partial(patches.write, self._patches, proposal, others, sha256)
        writing = loop.run_in_executor(None, work)
        try:
            await asyncio.shield(writing)
        finally:
            # Nobody else writes them meanwhile, even if we are cancelled.
            await asyncio.wait([writing])

    # --- decisions --------------------------------------------------------------------------------

    async def accept(self, number: int, who: str) -> None:
        """Load the patch of a proposal in place of the running one.

        Raises
        ------
        UserError
            If it is not open, the model has changed since, or it cannot be recorded.
        """
        async with self._turn:
            decided = self.loop.decided(ProposalStep.ACCEPT, number)
            differing = self._differing
            loaded, others = patches.split(differing)
            if loaded != present(decided):
                raise ControlRefused(
                    f"the parameters have changed since proposal {number} was made; accepting it"
                    " would undo that: reject it, and the next look starts from the present model"
                )
            # Written again: what was shown is accepted, whatever has become of the file since.
            await self._write(decided, others)
            if self._differing != differing:
                raise ControlRefused(
                    f"the parameters have changed while the patch of proposal {number} was written;"
                    " accepting it would undo that: try again"
                )
            self._history.append("decision", who=who, proposal=decided.as_json())
            try:
                await self._world.files.patches.load(decided.patch)
            except BaseException as error:
                if self._world.files.patches.loaded == decided.patch:
                    self._accepted(decided, who)  # loaded all the same
                else:
                    # The decision had no effect.
                    why = str(error) or type(error).__name__
                    self.figures.decisions["undone"] += 1
                    left = self.loop.proposal
                    assert left is not None
                    with contextlib.suppress(FailedError):
                        self._history.append(
                            "undone", why=why[:MOST_TEXT], proposal=left.as_json()
                        )
                raise
            self._accepted(decided, who)

    def _accepted(self, decided: Proposal, who: str) -> None:
        self.loop.adopt(decided, self._news.last + 1)
        self._gap.restart()
        self._decided(decided, who)

    def _decided(self, decided: Proposal, who: str) -> None:
        sentence = f"proposal {decided.number} was {decided.stage} by {who}"
        self._last = {
            "kind": "decision",
            "verdict": str(decided.stage),
            "sentence": sentence,
        }
        self.figures.decisions[str(decided.stage)] += 1
        self._say(sentence)

    def refused(self, sentence: str) -> None:
        """Count a refused decision; announce it unless the same was announced just before."""
        self.figures.decisions["refused"] += 1
        now_s = time.monotonic()
        self._refusals = {
            t: s for t, s in self._refusals.items() if now_s - s < REPEATED_S
        }
        if sentence not in self._refusals and len(self._refusals) < MOST_REFUSALS:
            self._refusals[sentence] = now_s
            self._say(sentence, 400)

    async def reject(self, number: int, who: str) -> None:
        """Reject a proposal, which is then not repeated; UserError as for `accept`."""
        await self._decide(ProposalStep.REJECT, number, who)

    async def postpone(self, number: int, who: str) -> None:
        """Leave a proposal open and remind nobody; UserError as for `accept`."""
        await self._decide(ProposalStep.POSTPONE, number, who)

    async def _decide(self, step: ProposalStep, number: int, who: str) -> None:
        async with self._turn:
            decided = self.loop.decided(step, number)
            self._history.append("decision", who=who, proposal=decided.as_json())
            self.loop.adopt(decided, self._news.last + 1)
            self._decided(decided, who)

    @property
    def _differing(self) -> dict[str, float]:
        parameters = self._world.parameters
        return {} if parameters is None else dict(parameters.differing)

    # --- the gap ----------------------------------------------------------------------------------

    def publish(self, frame: Frame) -> None:
        """Keep the newest frame."""
        self._frame = frame

    def supervise(self) -> None:
        """Compare measured with simulated values."""
        if self._frame is None or not self._jobs:
            return
        channel = self._gap.take(self._frame)
        if channel is not None and self.loop.changed is None:
            self.loop.changed = channel
            self._say(
                f"the gap of {channel} has left its usual range; a look will follow",
                400,
            )

    # --- what doors show --------------------------------------------------------------------------

    def _note(self, note: Note, **more: Any) -> None:
        """Write a line of the history, count it, and announce it."""
        verdict = str(note.fields.get("verdict", ""))
        if note.kind == "look":
            self.figures.looks[verdict] += 1
        if note.kind == "failed":
            self.figures.failures += 1
        sentence = note.sentence or str(note.fields.get("sentence", ""))
        self._last = {
            "kind": note.kind,
            "verdict": verdict,
            "sentence": sentence[:MOST_TEXT],
        }
        try:
            self._history.append(note.kind, **{**more, **note.fields})
        except FailedError as error:
            self._failed(str(error))
        if note.sentence:
            self._say(note.sentence, note.severity)

    def _failed(self, text: str) -> None:
        self.figures.failures += 1
        self._say(text, 500)

    def _say(self, text: str, severity: int = 200) -> None:
        now_ns = time.monotonic_ns()
        event = Event(
            EventKind.RECALIBRATION, severity, self.section, text[:MOST_TEXT], now_ns
        )
        self._world.events.publish(event)

    def _counted(self) -> Figures:
        proposal = self.loop.proposal if self._jobs else None
        self.figures.waits = (
            proposal is not None and proposal.stage is ProposalStage.OPEN
        )
        self.figures.changed = bool(self._jobs) and self.loop.changed is not None
        if proposal is not None and proposal.effect:
            self.figures.effect = {n: q.ratio for n, q in proposal.effect.items()}
        return self.figures

    def table(self) -> Table:
        """Return the figures of the nodes ``recalibration.*``."""
        now = self._counted()
        p = (self.loop.proposal if self._jobs else None) or Proposal(0, (), "", {})
        look: dict[str, Figure] = {
            "count": now.looks.total(),
            "is_looking": now.is_looking,
            "gap_changed": now.changed,
            "failures": now.failures,
            "kind": self._last["kind"],
            "verdict": self._last["verdict"],
            "sentence": self._last["sentence"],
        }
        proposal: dict[str, Figure] = {
            "number": p.number,
            "stage": str(p.stage) if p.number else "",
            "causes": ", ".join(p.causes),
            "sentence": p.sentence[:MOST_TEXT],
            "terms": ", ".join(f"{n} = {t.value:.4g}" for n, t in p.terms.items()),
            "patch": p.patch,
            "p": p.p,
        }
        return {"look": look, "proposal": proposal}

    def view(self) -> dict[str, Any]:
        """Return what the page shows."""
        proposal = self.loop.proposal if self._jobs else None
        newest = None if proposal is None else proposal.as_json()
        return {"look": self.table()["look"], "proposal": newest}
