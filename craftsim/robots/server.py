"""Robots behind a simulated network, and their server: in real time, at a share of it, or in lock-step."""

from __future__ import annotations

import heapq
import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from craftsim.errors import InputError
from craftsim.robots.fleet import Robot
from craftsim.robots.messages import (
    COPIES,
    Ack,
    Bye,
    Commands,
    Hello,
    Measurements,
    Message,
    MessageError,
    Refused,
    TruePoses,
    Welcome,
    pack,
    unpack,
)
from craftsim.robots.sockets import Host
from craftsim.skills.fleet import PhysicsFleet
from craftsim.skills.skill import Command
from craftsim.workers.copying import NotCopyable

WATCHDOG_S: Final = 0.1
"""Time without a command after which robots stop by themselves: five control periods."""
LEASE_S: Final = 2.0
"""Time without a message from the driver after which another one may drive the robots."""
_PATIENCE_S: Final = 60.0
"""Time limit of an answer in lock-step, by this machine's clock; after it the robots' time goes on without."""
_MOST: Final = 10_000
"""Largest number of messages under way; more are lost."""
_KEPT: Final = 64
"""Largest number of commands that wait for their time."""
_AHEAD_S: Final = 1.0
"""Longest time that a command may arrive before it is due."""
_EPSILON_S: Final = 1e-6
_TOLD: Final = 10
"""Lines about messages that are printed within _LATELY_S, so that no sender fills a disk."""
_LATELY_S: Final = 60.0
"""By the robots' clock."""
_LOOK_S: Final = 0.1
_AT_ONCE: Final = 128
"""Messages that are read before the robots' time goes on, however many wait."""


@dataclass(frozen=True)
class Network:
    """Delays and losses of messages on their way, in each direction, and the cars that fall silent."""

    delay_s: float = 0.0
    """Mean time that a message takes."""
    jitter_s: float = 0.0
    """Half-width of the uniform distribution around it."""
    loss: float = 0.0
    """Share of the messages that never come."""
    silent: tuple[tuple[int, float], ...] = ()
    """Cars that stop and say nothing any more, each with the second of its clock from which on."""

    def __post_init__(self) -> None:
        if not (0 <= self.jitter_s <= self.delay_s <= 10 or self.delay_s == self.jitter_s == 0):
            raise InputError(
                f"a network with a delay of {self.delay_s:g} s and a jitter of {self.jitter_s:g} s; allowed: a delay "
                "of 0 to 10 s, and a jitter of 0 to the delay"
            )
        if not 0 <= self.loss <= 1:
            raise InputError(f"a network that loses {self.loss:g} of its messages; allowed: 0 to 1")
        for car, from_s in self.silent:
            if not 0 <= from_s < math.inf:
                raise InputError(f"car {car} falls silent after {from_s:g} s; allowed: 0 s or more")


class Channel:
    """One direction of a network: messages come late, by a time that varies, so they may overtake each other."""

    def __init__(self, network: Network, rng: np.random.Generator) -> None:
        self._network = network
        self._rng = rng
        self._under_way: list[tuple[float, int, Any]] = []
        self._sent = 0

    def send(self, now_s: float, message: Any) -> None:
        """Take a message at a time."""
        network = self._network
        late, lost = self._rng.uniform(size=2).tolist()
        self._sent += 1
        if lost < network.loss or len(self._under_way) == _MOST:
            return
        # Rounded, so that what takes whole periods comes at their ends.
        due_s = round(now_s + network.delay_s + network.jitter_s * (2 * late - 1), 9)
        heapq.heappush(self._under_way, (due_s, self._sent, message))

    @property
    def due_s(self) -> float:
        """Time at which the next message comes out; infinite where none is on its way."""
        if self._under_way:
            return self._under_way[0][0]
        return math.inf

    def due(self, now_s: float) -> list[Any]:
        """Return the messages that have come out by a time, in the order in which they came."""
        messages = []
        while self.due_s <= now_s:
            messages.append(heapq.heappop(self._under_way)[2])
        return messages


class Inbox:
    """The commands of one driver, numbered by it: which is to be obeyed now, and whether too long none has come."""

    def __init__(self) -> None:
        self.heard_s = 0.0
        """Time at which the newest command came."""
        self.stops = self.dropped = 0
        """How often too long none came; commands that came after newer ones had begun, or too early."""
        self.begin()

    def begin(self) -> None:
        """Forget the driver: the next one counts anew."""
        self.heard, self.late_s, self.standing = 0, 0.0, True
        """Number of the newest command that came, by how much after its time it did, and whether robots stand."""
        self._obeyed: Commands | None = None
        self._waiting: list[Commands] = []
        self._taken: deque[int] = deque(maxlen=4 * _KEPT)

    def take(self, message: Commands, now_s: float) -> bool:
        """Take a command that has come, and return whether it is of use."""
        if message.number in self._taken:
            return False
        obeyed = 0
        if self._obeyed is not None:
            obeyed = self._obeyed.number
        if (
            message.number < obeyed
            or len(self._waiting) == _KEPT
            or message.at_s > now_s + _AHEAD_S
        ):
            self.dropped += 1
            return False
        self._taken.append(message.number)
        if message.number > self.heard:
            self.heard = message.number
            self.late_s = now_s - message.at_s
            self.heard_s = now_s
            self.standing = False
        self._waiting.append(message)
        return True

    def obey(self, now_s: float) -> Commands | None:
        """Return what the motors are to do from now on; None stops them."""
        if not self.standing and now_s - self.heard_s > WATCHDOG_S - _EPSILON_S:
            self.stops += 1
            self.standing = True
            self._waiting = []
        if self.standing:
            return None
        due = [message for message in self._waiting if message.at_s <= now_s + _EPSILON_S]
        if due:
            newest = max(due, key=lambda message: message.number)
            self._obeyed = newest
            self._waiting = [message for message in self._waiting if message.number > newest.number]
        return self._obeyed


class Service(NotCopyable):
    """Some robots in one world and whoever drives them: one event after the other in the robots' own time."""

    _instead = "there is one of each robot: set up another world"

    def __init__(
        self,
        robots: Sequence[Robot],
        fleet: PhysicsFleet,
        send: Callable[[bytes, bytes], None],
        network: Network,
        rngs: Sequence[np.random.Generator],
        world: str = "",
        waits: bool = False,
        tell: Callable[[str], None] = lambda line: None,
    ) -> None:
        """Begin at time 0.

        Args:
            robots: in the order of their cars' ids.
            fleet: of their cars.
            send: sends (to whom, what).
            network: the way of commands and of measurements; ``rngs`` draw what becomes of these, and of those.
            world: digest of the world, which a driver's must equal; empty for any.
            waits: whether their time stands still until each measurement has been answered.
            tell: says who comes, when the robots stop, and why a message was dropped.
        """
        self.robots = tuple(robots)
        self._fleet = fleet
        self._send = send
        self._tell = tell
        self._up, self._down = (Channel(network, rng) for rng in rngs)
        self.period_s = fleet.physics.config.control_period_s
        self.world = world
        self.waits = waits
        self.inbox = Inbox()
        self.driver: bytes | None = None
        """The driver whose commands are obeyed."""
        self.abandoned = False
        """Whether the driver has gone without a word: the watchdog will stop the robots, and somebody else may come."""
        self._driver_s = self.now_s = 0.0
        """Times at which it was heard last, and now."""
        self.stopped_at_s: list[float] = []
        """Times at which the robots stopped because no command came."""
        self.periods = self.number = 0
        """Control periods that are over, and measurements that were made."""
        self._told: deque[float] = deque(maxlen=_TOLD)
        """Times of the last lines about what became of messages."""
        self.malformed = self.farewells = 0
        """Messages that were none, or out of place; drivers that said goodbye, or are gone."""
        self.unseen: set[int] = set()
        """Measurements on which robots that wait have no answer yet."""

    @property
    def next_s(self) -> float:
        """Time of the next event, by the robots' clock."""
        return min(self._period_end_s, self._up.due_s, self._down.due_s)

    @property
    def _period_end_s(self) -> float:
        return round(self.periods * self.period_s, 9)

    def arrive(self, sender: bytes, data: bytes, now_s: float) -> None:
        """Take what has come; a command is then on its way, all else is there at once."""
        try:
            message = unpack(data)
            self.check(sender, message)
        except MessageError as error:
            self.malformed += 1
            self.mention(f"dropped a message: {error}")
            return
        if isinstance(message, Commands):
            self._up.send(now_s, (sender, message))
        else:
            self._receive(sender, message, now_s)

    def check(self, sender: bytes, message: Message) -> None:
        """Raise MessageError for a message that is out of place."""
        if isinstance(message, Hello):
            return
        if not isinstance(message, Commands | Ack | Bye):
            raise MessageError(f"{message.kind} is nothing to tell robots")
        if sender != self.driver:
            raise MessageError(f"{message.kind} of somebody who does not drive the robots")
        if isinstance(message, Commands) and len(message.cars) != len(self.robots):
            raise MessageError(
                f"commands for {len(message.cars)} cars; there are {len(self.robots)}"
            )

    def depart(self, sender: bytes) -> None:
        """Go on without somebody whose connection is closed."""
        if sender == self.driver:
            self.abandoned = True
            self.farewells += 1
            self.unseen.clear()

    def _receive(self, sender: bytes, message: Message, now_s: float) -> None:
        if isinstance(message, Hello):
            answer = self.greet(sender, message, now_s)
            self._send(sender, pack(answer))
            self.mention(f"{now_s:.2f} s: {answer.kind}")
            return
        self._driver_s = now_s
        if isinstance(message, Commands):
            self.inbox.take(message, now_s)
        elif isinstance(message, Ack):
            self.unseen.discard(message.number)
        else:
            self.leave()
            self.farewells += 1
            self.unseen.clear()

    def greet(self, sender: bytes, hello: Hello, now_s: float) -> Message:
        """Return the answer to a greeting; from a Welcome on its sender is the driver."""
        silent = self.abandoned or now_s - self._driver_s >= LEASE_S
        if self.driver not in (None, sender) and not silent:
            return Refused(
                "the robots obey somebody else; try again when that has ended", busy=True
            )
        if hello.cars != len(self.robots):
            return Refused(f"there are {len(self.robots)} robots, not {hello.cars}")
        if self.world and hello.world and hello.world != self.world:
            return Refused(
                "the robots stand in another world; start both with the same task and files"
            )
        self.inbox.begin()
        self.driver = sender
        self._driver_s = now_s
        self.abandoned = False
        self.unseen.clear()
        n_slopes = len(self._fleet.physics.slopes)
        return Welcome(len(self.robots), n_slopes, self.period_s, WATCHDOG_S, True, self.waits)

    def leave(self) -> None:
        """Let the driver go; the robots stop."""
        self.driver = None
        self.abandoned = False
        self.inbox.begin()

    def step(self) -> None:
        """Let happen what happens next."""
        now_s = self.now_s = self.next_s
        self._deliver(now_s)
        for sender, commands in self._up.due(now_s):
            if sender == self.driver:
                self._receive(sender, commands, now_s)
        if self._period_end_s > now_s:
            return
        if self.number == self.periods:
            # What is commanded in answer comes before the robots act where it takes no time.
            self._measure(now_s)
        else:
            self._act(now_s)
            self.periods += 1
            self._fleet.advance()

    def _measure(self, now_s: float) -> None:
        self.number += 1
        inbox = self.inbox
        cars = tuple(robot.measure() for robot in self.robots)
        measured = Measurements(self.number, now_s, inbox.heard, inbox.late_s, inbox.stops, cars)
        if self.driver is not None:
            self._send(self.driver, pack(self._true_poses(now_s)))
            for _ in range(COPIES):
                self._down.send(now_s, measured)
            self._deliver(now_s)

    def _true_poses(self, now_s: float) -> TruePoses:
        physics = self._fleet.physics
        n_cars = len(self.robots)
        poses = tuple(map(tuple, physics.data.qpos[physics.pose_places].tolist()))
        hinges = tuple(float(physics.data.qpos[slope.hinge.qpos]) for slope in physics.slopes)
        return TruePoses(now_s, poses[:n_cars], poses[n_cars:], hinges, physics.capped_steps)

    def _act(self, now_s: float) -> None:
        before = self.inbox.stops
        commands = self.inbox.obey(now_s)
        if self.inbox.stops > before:
            self.stopped_at_s.append(now_s)
            self._tell(
                f"{now_s:.2f} s: no command since {self.inbox.heard_s:.2f} s, the robots stop"
            )
        for car, robot in enumerate(self.robots):
            robot.command(Command() if commands is None else commands.cars[car])
        if self.abandoned and self.inbox.standing:
            self.leave()

    def mention(self, line: str) -> None:
        """Say a line about messages or connections, unless as much was said lately as is allowed."""
        if len(self._told) < _TOLD or self.now_s - self._told[0] >= _LATELY_S:
            self._told.append(self.now_s)
            self._tell(line)

    def _deliver(self, now_s: float) -> None:
        for message in self._down.due(now_s):
            if self.driver is not None:
                self._send(self.driver, pack(message))
                if self.waits:
                    self.unseen.add(message.number)


class Server:
    """Lets the time of robots pass as the clock of this machine does, and messages come and go."""

    def __init__(
        self,
        service: Service,
        sockets: Host,
        pace: float = 1.0,
        patience_s: float = _PATIENCE_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Serve robots over sockets, ``pace`` seconds of their time in one; in lock-step wait so long for an answer."""
        self._service = service
        self._sockets = sockets
        self._pace = pace
        self._patience_s = patience_s
        self._clock = clock
        self.behind_s = 0.0
        """Total delay of the robots' time, because physics took longer; it is not caught up."""
        self._silent = False
        """Whether who drives robots in lock-step has left their patience to run out."""
        self._heard = clock()
        """Time at which their driver was heard last, or had last nothing to say."""
        self._keep_time()

    def run(self, ended: Callable[[], bool]) -> None:
        """Serve until somebody says so."""
        service = self._service
        while not ended():
            if service.waits and service.driver is None:
                self._take(_LOOK_S)
                self._keep_time()
            elif self._in_step and service.unseen:
                left_s = self._heard + self._patience_s - self._clock()
                self._silent = left_s <= 0
                self._take(max(0.0, min(left_s, _LOOK_S)))
                self._keep_time()
            elif self._in_step:
                service.step()
                self._heard = self._clock()
            else:
                self._pass_time()

    def end(self) -> None:
        """Say goodbye to who drives the robots."""
        if self._service.driver is not None:
            self._sockets.send(self._service.driver, pack(Bye("somebody has ended them")))

    def _pass_time(self) -> None:
        left_s = self._wall_s(self._service.next_s) - self._clock()
        if left_s > 0:
            self._take(min(left_s, _LOOK_S))
            return
        for _ in range(_AT_ONCE):
            if not self._take(0.0):
                break
        self._service.unseen.clear()  # nobody is waited for
        self._service.step()
        behind_s = (self._clock() - self._wall_s(self._service.now_s)) * self._pace
        if behind_s > self._service.period_s:
            self.behind_s += behind_s
            self._keep_time()

    def _take(self, timeout_s: float) -> bool:
        """Take the next message that comes in time; return whether one does."""
        service = self._service
        received = self._sockets.receive(timeout_s, service.driver)
        if received is None:
            return False
        sender, data = received
        if data is None:
            service.depart(sender)
            if sender == service.driver:
                self._keep_time()
            return True
        robots_s = self._anchor[1] + (self._clock() - self._anchor[0]) * self._pace
        if self._in_step:
            now_s = service.now_s
        else:
            now_s = min(max(robots_s, service.now_s), service.next_s)
        service.arrive(sender, data, now_s)
        if sender == service.driver:
            self._heard = self._clock()
            self._silent = False
        return True

    @property
    def _in_step(self) -> bool:
        """Whether the robots' time waits for their driver."""
        return self._service.waits and not self._silent and not self._service.abandoned

    def _keep_time(self) -> None:
        self._anchor = self._clock(), self._service.now_s

    def _wall_s(self, robots_s: float) -> float:
        return self._anchor[0] + (robots_s - self._anchor[1]) / self._pace
