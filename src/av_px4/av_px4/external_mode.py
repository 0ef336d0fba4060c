"""Registration of an external mode of PX4 ("AV Track"), which the pilot can select.

PX4 asks every registered component several times a second whether it can run, and leaves the mode when no reply
arrives. These requests also confirm to this client that the registration is still valid.

PX4 lists a mode once for each request that it grants, and forgets one by itself only when disarmed. So this client asks only
while PX4 is heard, ends what it knows to be registered before it asks again, and ends what PX4 grants a second time.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

from av_px4.guard import EXTERNAL_MODES

API_VERSION = 1        # px4_ros2_api_version
RETRY_S = 2.0          # interval between requests for registration
LOST_AFTER_S = 2.0     # time without an arming check request after which the registration counts as lost
GRACE_S = 5.0          # the same limit before the first arming check request
SETTLE_S = 1.0         # between the end of a registration and the next request; PX4 drops a silent one in this time, too


@dataclass(frozen=True)
class Register:
    """A request to register an external mode.

    Parameters:
        request_id: number that the reply repeats
        name: name of the mode in the ground station
    """

    request_id: int
    name: str


@dataclass(frozen=True)
class Registration:
    """A registration that PX4 has granted.

    Parameters:
        name: name of the mode
        arming_check_id: number of this registration in replies to arming checks
        mode_id: nav_state of the mode
    """

    name: str
    arming_check_id: int
    mode_id: int


@dataclass(frozen=True)
class Answer:
    """Reply to an arming check.

    Parameters:
        request_id: number of PX4's request
        registration_id: number of the registration
        can_run: whether the mode can run now
    """

    request_id: int
    registration_id: int
    can_run: bool


class ExternalMode:
    """Client of PX4's registration: it registers, answers arming checks, and registers again after a loss.

    Raises ValueError for a name that PX4 cannot store.

    Parameters:
        name: name of the mode in the ground station, 1 to 24 bytes
        seed: seed of the random request numbers, for tests
    """

    def __init__(self, name: str = 'AV Track', seed: int | None = None) -> None:
        if not 0 < len(name.encode()) < 25:
            raise ValueError(f'external mode name is {name!r}, expected 1 to 24 bytes')
        self.name = name
        self.registration: Registration | None = None
        self.problem = ''
        self._random = random.Random(seed)
        self._requests: list[int] = []        # the newest, of which any may still be granted
        self._ended: list[Registration] = []  # which PX4 may still have
        self._next = math.inf                 # time of the next request
        self._question_at = -math.inf

    def start(self, time: float, former: Registration | None = None) -> None:
        """Begin to register.

        Parameters:
            time (s): monotonic
            former: the registration of an earlier process of this node, which PX4 may still have
        """
        self._next = time + SETTLE_S
        self._ended += [former] if former else []

    def step(self, time: float, heard: bool) -> Register | Registration | None:
        """What to send: a request, or a registration to end; None if nothing is due.

        Parameters:
            time (s): monotonic
            heard: whether PX4 is heard and reads what is sent; else it may be lost, or wait and arrive in a crowd
        """
        if self.registration is not None and time > self._question_at + LOST_AFTER_S:
            self._ended.append(self.registration)
            self.forget('PX4 no longer asks for it')
        if not heard:
            self._next = max(self._next, time + SETTLE_S)
            return None
        if time < self._next:
            return None
        if self._ended:
            self._next = time + SETTLE_S
            return self._ended.pop()
        if self.registration is not None:
            return None
        self._next = time + RETRY_S
        self._requests = [*self._requests[-9:], self._random.getrandbits(63)]
        return Register(self._requests[-1], self.name)

    def on_reply(self, time: float, request_id: int, name: str, api_version: int, success: bool,
                 arming_check_id: int, mode_id: int) -> Registration | None:
        """Process a reply and return the registration if PX4 granted one. Replies to other components are ignored.

        Parameters:
            time (s): arrival, monotonic
            request_id, name, api_version, success, arming_check_id, mode_id: fields of RegisterExtComponentReply
        """
        if request_id not in self._requests or name != self.name:
            return None
        self._requests.remove(request_id)
        granted = Registration(name, arming_check_id, mode_id)
        if success and self.registration is not None:
            self._ended += [granted] if granted != self.registration else []
            return None
        if not success:
            self.problem = 'PX4 refused the registration'
        elif api_version != API_VERSION:
            self.problem = f'PX4 has version {api_version} of the interface for external modes, expected {API_VERSION}'
        elif mode_id not in EXTERNAL_MODES or arming_check_id < 0:
            self.problem = f'PX4 gave mode {mode_id} and check {arming_check_id}, expected a mode of 23 to 30'
        else:
            self.problem = ''
            self.registration = granted
            self._question_at = time + GRACE_S - LOST_AFTER_S
        return self.registration

    def on_question(self, time: float, request_id: int, can_run: bool, valid_mask: int | None = None) -> Answer | None:
        """The reply to an arming check, None while no mode is registered.

        Parameters:
            time (s): monotonic
            request_id: number of PX4's request
            can_run: whether the mode can run now
            valid_mask: one bit for each registration that PX4 regards as alive, None before PX4 1.17
        """
        if self.registration is None:
            return None
        number = self.registration.arming_check_id
        first = self._question_at > time
        if valid_mask is None or valid_mask >> number & 1 or first:
            self._question_at = max(self._question_at, time)
        return Answer(request_id, number, can_run)

    def active_mode(self, time: float) -> int | None:
        """nav_state of the registered mode if the registration is confirmed at `time` (s, monotonic), else None."""
        if self.registration is None or time > self._question_at + LOST_AFTER_S:
            return None
        return self.registration.mode_id

    def forget(self, why: str) -> None:
        """Discard the registration; `why` becomes the reported problem."""
        self.registration, self.problem = None, why
