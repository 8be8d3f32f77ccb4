"""The robot's program in ROS 2: publishes, subscribes to and serves what its flavour lists.

A host is a source like an OPC UA peer: the input gate decides whether it commands, its silence is
judged, and its figures are those of a peer named ``ros2``.
"""

import asyncio
import time
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, Final

from hilserver.config.doors import Right
from hilserver.config.ros2 import LOOPBACK, Ros2Config
from hilserver.core.events import Event, EventKind
from hilserver.core.staleness import Transition
from hilserver.faults.links import Lane, PeerLine
from hilserver.image import Frame
from hilserver.io.arrival import WATCH_S
from hilserver.io.link_status import LinkState
from hilserver.io.ros2 import graph
from hilserver.io.ros2.domain_watch import DomainWatch
from hilserver.io.ros2.neighbours import Neighbours
from hilserver.io.ros2.parameters import NODE, ParameterServices
from hilserver.io.ros2.participant import Arrival, In, Out, Participant
from hilserver.io.ros2.real_robot import RealRobot
from hilserver.io.ros2.replies import Replies
from hilserver.io.ros2.services import RosService
from hilserver.io.ros2.status import CommandState, Ros2Fault, Ros2Status
from hilserver.io.ros2.stepping import PERIOD_S, STEP, Stepping
from hilserver.io.ros2.way_back import WayBack
from hilserver.io.ros2.wire import WireTypes
from hilserver.io.source import Source
from hilserver.io.world import Part, World
from hilserver.ros import incoming
from hilserver.ros.flavours import (
    DESCRIPTION,
    FLAVOURS,
    JOY,
    Published,
    Served,
    Subscribed,
)
from hilserver.ros.robot import Odometer, RosFrame
from hilserver.ros.types import Types
from hilserver.signals import State
from hilserver.tasks import SupervisedTask

NAME: Final = "ros2"
LOOK_EVERY: Final = 25

Receiver = Callable[[Arrival], None]


class Ros2Node(Part):
    """One node for as long as the daemon runs."""

    section, label, is_early = NAME, "ROS 2", True  # joining takes a second
    status: Ros2Status  # always up to date

    def __init__(self, config: Ros2Config, world: World, line: PeerLine) -> None:
        self.config, self._world = config, world
        self._flavour = FLAVOURS[config.flavour]
        self._types = Types(config.service_fields)
        self._wire = WireTypes(self._types)
        space = (config.namespace or self._flavour.namespace).strip("/")
        self.robot = RosFrame(
            self._types,
            world.shape,
            Odometer(world.shape),
            array_order=config.array_order,
            frame_prefix=f"{space}/" if space else "",
        )
        self._names = [signal.name for signal in world.table.scalars]
        how = f"{config.flavour} on {config.interface}"
        self.status = Ros2Status(NAME, how, mode="dds")
        self._source = Source(
            config.driver._replace(on_stale=self._action),
            "ROS 2",
            self.status,
            world.gate,
            world.events.publish,
            fresh=lambda: "ROS 2: the host sends fresh commands",
            kinds=Ros2Fault,
        )
        self._line = line
        self._arriving: Lane[list[tuple[Receiver, Arrival]]] = Lane(line, "in")
        self._leaving: Lane[list[tuple[str, Out, bytes]]] = Lane(line, "out")
        self._participant: Participant | None = None
        self._outs: dict[str, tuple[Published, Out]] = {}
        # a topic may have several types
        self._ins: list[tuple[str, Subscribed, In]] = []
        self._services: list[RosService] = []
        self._jobs: list[SupervisedTask] = []
        self._stepping = Stepping(world.control, world.image, world.period_ns)
        # writer of the newest command, and the simulated time of its arrival
        self._cycle = self._watched = self._commander = self._commanded_ns = 0
        self._newest: list[tuple[str, Out, bytes]] = []
        self._news_ns: int | None = None
        self._neighbours: Neighbours | None = None
        self._replies: Replies | None = None
        self._domain_watch: DomainWatch | None = None
        self.real: RealRobot | None = None  # whose topics are read beside ours
        if config.measured is not None:
            self.real = RealRobot(config, config.measured, world, self._types)
        self._announced: Out | None = None
        self._way_back = WayBack(command_enables=config.command_enables)
        # topic that commands no longer: the one that does
        self._taken_over: dict[str, str] = {}
        world.control.on_reset.append(self._taken_over.clear)

    @property
    def _action(self) -> str:
        """What happens to a command that is not renewed, in words."""
        action, service = self.config.action, self._flavour.enabled_by
        if action == "hold":
            return f"{action}: it stood while its writer was alive, now Reset ends the safe state"
        if action == "zero":
            return f"{action}: the next command drives again"
        if action != "device":
            return action
        ways = [self.config.full_name(service)] if service else []
        if self.config.command_enables:
            ways.append("a command after one at rest")
        return f"{action}: {' or '.join(ways)} enables the drive again"

    @property
    def address(self) -> str:
        """Its domain and interface, for people."""
        number = "?" if self._participant is None else self._participant.number
        return f"{self.config.flavour} in domain {number} on {self.config.interface}"

    @property
    def domain(self) -> int:
        """The DDS domain, ROS_DOMAIN_ID, once it has started."""
        assert self._participant is not None
        return self._participant.number

    @property
    def others(self) -> set[bytes]:
        """Who else is in the domain."""
        return set(self._neighbours.known) if self._neighbours is not None else set()

    def forget_host(self) -> set[bytes]:
        """Let a command stand no longer because its writer is alive; return who may be it."""
        self._commander = 0
        self._stepping.forget()
        self._age_command()
        return self.others

    def _age_command(self) -> None:
        """Let the last command be as old as simulated time says, however long that has stood."""
        if not self._look():
            return
        age_ns = self.robot.time_ns - self._commanded_ns
        if age_ns < self._source.staleness.limit_ns:
            self._world.gate.leases.renew(NAME, -age_ns)

    # --- start and stop ---------------------------------------------------------------------------

    async def start(self) -> None:
        """Join the domain, which takes a second; then publish, subscribe and serve.

        FailedError if that is not possible.
        """
        self._participant = await asyncio.to_thread(self._join)
        self._neighbours = neighbours = Neighbours(self._participant)
        number = self._participant.number
        self._domain_watch = DomainWatch(
            self.status, self._source.faults, neighbours, number
        )
        local = self.config.interface in LOOPBACK
        given_up = partial(self._report, Ros2Fault.NOT_TAKEN)
        self._replies = Replies(neighbours, given_up, local=local)
        self._participant.listen(self._on_data)
        self.status.state = LinkState.CONNECTING
        self._jobs = [
            self._world.tasks.keep("ros2: publish", self._publish_for_ever),
            self._world.tasks.every("ros2: watch", WATCH_S, self._watch),
        ]

    def _join(self) -> Participant:
        participant, wire = Participant(self.config), self._wire

        def opened(open_one: Callable[..., Any], topic: Any) -> tuple[str, Any, Any]:
            name, kind = self.config.full_name(topic.topic), topic.type
            made = open_one(
                f"rt{name}", wire.make(kind), topic.qos, self._types.hash(kind)
            )
            return name, topic, made

        written = [opened(participant.writer, topic) for topic in self.config.published]
        self._outs = {name: (topic, writer) for name, topic, writer in written}
        self._ins = [
            opened(participant.reader, topic) for topic in self._flavour.subscribed
        ]
        self._services = [
            RosService(served, self.config, self._types, wire, participant)
            for served in (
                *self._flavour.served,
                *self._parameter_services(),
                self._stepping.served(),
            )
        ]
        if self.real is not None:
            self.real.join(participant, wire)
        space = self.config.full_name(NODE).rpartition("/")[0] or "/"
        ours = [endpoint for _, endpoint in self._endpoints()]
        ours += [
            endpoint for service in self._services for endpoint in service.endpoints
        ]
        self._announced = graph.announce(
            participant, self._types, wire, (space, NODE), ours
        )
        kinds = [published.type for published, _ in self._outs.values()]
        for kind in kinds + [subscribed.type for _, subscribed, _ in self._ins]:
            self._types.prepare(kind)
        if self.config.publish.robot_description:
            name, description, writer = opened(participant.writer, DESCRIPTION)
            text = self._world.description(self.robot.frame_prefix)
            writer.write(
                self._types.encode(self.robot.make(description.type, data=text))
            )
            self._outs[name] = description, writer
        return participant

    def _parameter_services(self) -> Iterable[Served]:
        parameters = self._world.parameters
        if parameters is None:
            return ()
        doors = {door.source: door for door in self._world.config.doors}
        may_set = Right.PARAMETERS in doors[NAME].rights
        return ParameterServices(
            NAME, parameters, self._types, may_set=may_set
        ).served()

    async def stop(self) -> None:
        """Leave the domain."""
        jobs, self._jobs = self._jobs, []
        for job in jobs:
            await job.end()
        if self._participant is not None:
            await self._participant.close()
        self._outs, self._ins, self._services, self._participant = {}, [], [], None
        if self._replies is not None:
            self._replies.close()
        self._neighbours = self._announced = self._replies = self._domain_watch = None
        self.status.state, self.status.connected = LinkState.STOPPED, False

    # --- what goes out ----------------------------------------------------------------------------

    async def _publish_for_ever(self) -> None:
        loop = asyncio.get_running_loop()
        due_s = loop.time()
        while True:
            if not self._stepping.stands:
                self._publish()
            due_s += PERIOD_S
            late_s = loop.time() - due_s
            if late_s > PERIOD_S:
                skipped = int(late_s / PERIOD_S)
                self.status.writes_skipped += skipped
                self._cycle += skipped
                due_s += skipped * PERIOD_S
            await asyncio.sleep(max(0.0, due_s - loop.time()))

    def publish(self, frame: Frame) -> None:
        """Write the messages of a step, and answer it, as soon as its ticks have passed."""
        if self._stepping.is_over(frame):
            self._publish()
            self._stepping.end()

    def _look(self) -> bool:
        """Take the newest frame; False before the first."""
        frame = self._world.image.latest()
        if frame is None:
            return False
        robot = self.robot
        robot.values = dict(zip(self._names, frame.values.tolist(), strict=True))
        robot.time_ns = frame.tick * self._world.period_ns
        simulated = self.config.publish.clock
        robot.stamp_ns = (
            robot.time_ns if simulated else self._world.clock.utc_ns(frame.planned_ns)
        )
        return True

    def _publish(self) -> None:
        if not self._look():
            return
        self.robot.odometer.see(self.robot.values)
        batch = [
            (name, out, self._types.encode(message))
            for name, (published, out) in self._outs.items()
            if self._is_due(published)
            for message in published.make(self.robot)
        ]
        self._cycle += 1
        self._newest = batch
        self._leaving.put(batch)
        for due in self._leaving.take():
            self._write(due)

    def _is_due(self, published: Published) -> bool:
        if published.period_s is None:
            return self._cycle == 0
        return self._cycle % max(1, round(published.period_s / PERIOD_S)) == 0

    def _write(self, batch: list[tuple[str, Out, bytes]]) -> None:
        if self._line.is_cut:
            return
        self.status.writes += 1
        for name, out, cdr in batch:
            if not out.write(cdr):
                sentence = (
                    f"a reader of {name} requests a QoS that this writer does not offer"
                )
                self._report(Ros2Fault.NOT_TAKEN, name, sentence)

    # --- what comes in ----------------------------------------------------------------------------

    def _on_data(self) -> None:
        # Requests first: what was written before one of them, as a command before a step, is there.
        requests = [
            (service, request)
            for service in self._services
            for request in service.take()
        ]
        receivers: list[tuple[In, Receiver]] = [
            (reader, partial(self._receive, subscribed))
            for _, subscribed, reader in self._ins
        ]
        if self.real is not None:
            receivers.extend(self.real.receivers())
        arrived = [
            (receive, arrival)
            for reader, receive in receivers
            for arrival in self._fitting(reader)
        ]
        if arrived and not self._line.is_cut:
            self._arriving.put(arrived)
            self._receive_due()
        for service, request in requests:
            self._serve(service, request)

    def _fitting(self, reader: In) -> list[Arrival]:
        """Return what came in from writers that mean the same fields as we do."""
        if self._neighbours is None:
            return []
        has_our_fields = self._neighbours.has_our_fields
        return [
            one for one in reader.take() if has_our_fields(one.writer, reader.subject)
        ]

    def _receive_due(self) -> None:
        for batch in self._arriving.take():
            for receive, arrival in batch:
                receive(arrival)

    def _receive(self, subscribed: Subscribed, arrival: Arrival) -> None:
        now_ns = time.monotonic_ns()
        latency_ns = self._world.clock.utc_ns(now_ns) - arrival.source_ns
        if arrival.source_ns > 0:
            self.status.one_way.observe(max(latency_ns, 0))
        if not self._look():
            return
        try:
            message = self._types.decode(arrival.cdr, subscribed.type)
            values = subscribed.take(self.robot, message)
        except ValueError as error:
            self._report(
                Ros2Fault.BAD_MESSAGE, subscribed.topic, f"{subscribed.topic}: {error}"
            )
            return
        if self._news_ns is not None:
            self.status.interval.observe(now_ns - self._news_ns)
        self._news_ns = now_ns
        self.status.sequence_received += 1
        is_command = subscribed.commands and subscribed.topic not in self._taken_over
        if not is_command:
            values = {
                name: value
                for name, value in values.items()
                if name not in incoming.MOVING
            }
        if values:
            self._hand_over(subscribed, values, arrival, now_ns, is_command=is_command)

    def _hand_over(
        self,
        subscribed: Subscribed,
        values: incoming.Values,
        arrival: Arrival,
        now_ns: int,
        *,
        is_command: bool,
    ) -> None:
        self._see_lapse()
        if is_command and self._way_back.enables(values):
            values = values | {"drive.enable": True}
        of = f"{subscribed.topic}: "
        by_hand = subscribed.type == JOY
        wrong = self._source.write(
            values, now_ns, of=of, renews=is_command, by_hand=by_hand
        ).wrong
        if not is_command or wrong:
            return
        self._source.staleness.renew(now_ns)
        self.status.input_received_ns = dict.fromkeys(values, now_ns)
        self.status.command_ns = now_ns
        self._commander, self._commanded_ns = arrival.writer, self.robot.time_ns
        self._take_over(subscribed)

    def _take_over(self, subscribed: Subscribed) -> None:
        """Leave to the writer of this topic what it makes its messages from."""
        theirs = [name for name in subscribed.made_from if name not in self._taken_over]
        if not theirs:
            return
        self._taken_over |= dict.fromkeys(theirs, subscribed.topic)
        names = ", ".join(self.config.full_name(name) for name in theirs)
        text = (
            f"ROS 2: {self.config.full_name(subscribed.topic)} drives; {names} belong to the node"
            " that writes it and move nothing here until the simulation is reset"
        )
        self._world.events.publish(Event(EventKind.STATE, 300, NAME, text))

    def _see_lapse(self) -> None:
        """Note that silence has disabled the drive, or that this is over."""
        if self._world.control.state is State.SAFE:
            self._way_back.forget()
        elif self.config.action == "device" and self._world.gate.leases.has_lapsed(
            NAME
        ):
            self._way_back.withdraw()

    def _serve(self, service: RosService, request: Any) -> None:
        if self._replies is None:
            return
        number = self._replies.number(request)
        if self._line.is_cut or not self._look():
            return
        try:
            values, response = service.understand(self.robot, request)
        except ValueError as error:
            self._report(
                Ros2Fault.BAD_MESSAGE, service.name, f"{service.name}: {error}"
            )
            return
        replies = self._replies

        def answer(is_done: bool) -> None:
            service.answer(request, number, response(is_done), replies)

        now_ns = time.monotonic_ns()
        if service.name == self.config.full_name(STEP):
            self._hold(now_ns)
            self._begin_steps(now_ns, is_there=True)
            self._stepping.ask(request.writer, answer)
            return
        refusals, came_ns = {}, self._source.came_ns(now_ns)
        if values:
            # A service is no command that has to be renewed: who enables by hand may drive later,
            # and who only switches lights does not keep the command of another node alive.
            refusals = self._world.gate.write(
                NAME, values, commanded_ns=came_ns, renews=False
            )
            if "drive.enable" in values and not refusals:
                self._way_back.forget()
        answer(not refusals)

    # --- what is judged ---------------------------------------------------------------------------

    def _watch(self) -> None:
        self._receive_due()
        now_ns = time.monotonic_ns()
        if self._neighbours is not None:
            self._neighbours.look()
        if self._replies is not None:
            self._replies.send_waiting()
        self._watch_steps(now_ns)
        if not self._stepping.stands:
            self._hold(now_ns)
        elif self.status.command_ns is not None:
            # Nobody is late while time waits for him.
            self._source.staleness.renew(now_ns)
            self._age_command()
        self._see_lapse()
        if self._source.watch(now_ns) is Transition.LOST:
            self.status.command = CommandState.STALE
        if self.real is not None:
            self.real.watch(now_ns)
        if self._domain_watch is not None and self._watched % LOOK_EVERY == 0:
            services = [
                endpoint for service in self._services for endpoint in service.endpoints
            ]
            self._domain_watch.look(self._endpoints(), services)
        self._watched += 1

    def _watch_steps(self, now_ns: int) -> None:
        """Begin lockstep with a client of the service, and speak to it until it has heard us."""
        name = self.config.full_name(STEP)
        readers = [one.endpoints[0] for one in self._services if one.name == name]
        self._begin_steps(now_ns, is_there=any(one.matched for one in readers))
        self._stepping.go_on()
        if self._stepping.repeats(now_ns):
            self._write(self._newest)

    def _begin_steps(self, now_ns: int, *, is_there: bool) -> None:
        if self._stepping.begin(now_ns, is_there=is_there):
            self._cycle = 0  # slower topics count from here

    def _hold(self, now_ns: int) -> None:
        """Show where the last command stands; with `hold` renew it while its writer is alive."""
        status, staleness = self.status, self._source.staleness
        if self._neighbours is None or status.command_ns is None:
            return
        writer = self._neighbours.participant_of(self._commander)
        status.lease_s = writer.lease_s if writer else None
        if (
            self.config.action == "hold"
            and writer is not None
            and not self._line.is_cut
        ):
            staleness.renew(now_ns)
            self._world.gate.renew(NAME, now_ns)
        if not staleness.stale:
            is_late = now_ns - status.command_ns > staleness.limit_ns
            status.command = CommandState.HELD if is_late else CommandState.FRESH

    def _endpoints(self) -> list[tuple[str, Out | In]]:
        found: list[tuple[str, Out | In]] = [
            (name, out) for name, (_, out) in self._outs.items()
        ]
        found += [(name, reader) for name, _, reader in self._ins]
        return found + (self.real.endpoints if self.real is not None else [])

    def _report(self, kind: Ros2Fault, subject: str, sentence: str) -> None:
        self._source.faults.report(kind, subject, sentence, time.monotonic_ns())
