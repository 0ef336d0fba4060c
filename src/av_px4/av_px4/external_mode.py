"""Registration of an external mode of PX4 ("AV Track"), which the pilot can select.

PX4 asks every registered component several times a second whether it can run, and leaves the mode when no reply
arrives. These requests also confirm to this client that the registration is still valid.

PX4 lists a mode once for each request that it grants, and forgets one by itself only when disarmed. So this client asks only
while PX4 is heard, ends what it knows to be registered before it asks again, and ends what PX4 grants a second time or in a
version of the interface that this rig does not speak. What PX4 refuses is not asked for again and again.
"""

from __future__ import annotations

import math
import random
from collections.abc import Collection
from dataclasses import dataclass

from av_px4.handover import EXTERNAL_MODES, VehicleStatus

MODE_NAME = 'AV Track'  # in the ground station; PX4 stores 24 bytes
RETRY_S = 5.0          # interval between requests for registration: each that comes late is granted, too
REFUSED_S = 10.0       # the same after one that PX4 has refused; while it is armed none at all
LOST_AFTER_S = 2.0     # time without an arming check request after which the registration counts as lost
GRACE_S = 5.0          # the same limit before the first arming check request
SETTLE_S = 1.0         # between the end of a registration and the next request; PX4 drops a silent one in this time, too
CONFIGURE_S = 0.1      # interval between configurations of the setpoints, which PX4 wants after each selection of the mode
UNCONFIRMED = 3        # configurations of version 1, to which PX4 does not reply


@dataclass(frozen=True)
class Registration:
    """A registration that PX4 has granted.

    Parameters:
        arming_check_id: number of this registration in replies to arming checks
        mode_id: nav_state of the mode
        version: of PX4's interface for external modes
    """

    arming_check_id: int
    mode_id: int
    version: int = 1


@dataclass(frozen=True)
class Configure:
    """A configuration of the setpoints that a mode sends.

    Parameters:
        registration: of the mode
    """

    registration: Registration


class ExternalMode:
    """Client of PX4's registration: it registers, configures, answers arming checks, and registers again after a loss.

    Parameters:
        versions: of PX4's interface for external modes that the installed px4_msgs has the messages for
    """

    def __init__(self, versions: Collection[int] = (1, 2)) -> None:
        self.registration: Registration | None = None
        self.problem = ''
        self._versions = versions
        self._requests: list[int] = []        # the newest, of which any may still be granted
        self._ended: list[Registration] = []  # which PX4 may still have
        self._next = math.inf                 # time of the next request or end
        self._again = -math.inf               # time before which what was refused is not asked for
        self._disarmed_only = False           # PX4 refused a request while it was armed
        self._foreign = False                 # PX4 speaks a version that this rig does not
        self._question_at = -math.inf
        self._configured = self._configure_at = 0.0
        self._active = False

    def start(self, time: float, former: Registration | None = None) -> None:
        """Begin to register.

        Parameters:
            time (s): monotonic
            former: the registration of an earlier process of this node, which PX4 may still have
        """
        self._next = time + SETTLE_S
        self._ended += [former] if former and former != self.registration else []

    def step(self, time: float, heard: bool, status: VehicleStatus | None = None) -> int | Registration | Configure | None:
        """What to send: the number of a request, a registration to end, or a configuration; None if nothing is due.

        Parameters:
            time (s): monotonic
            heard: whether PX4 is heard and reads what is sent; else it may be lost, or wait and arrive in a crowd
            status: of the vehicle
        """
        if self.registration is not None and time > self._question_at + LOST_AFTER_S:
            self._ended.append(self.registration)
            self.forget('PX4 no longer asks for it')
        if not heard:
            self._next = max(self._next, time + SETTLE_S)
            self._foreign = False    # it may be another firmware that is heard next
            return None
        armed = status is not None and status.armed
        self._disarmed_only &= armed
        if status and armed and self._ended and self._ended[-1].mode_id in (status.nav_state, status.intended):
            return None    # to end the mode that the pilot has selected would change the mode, also in a failsafe
        if time >= self._next and self._ended:
            self._next = time + SETTLE_S
            return self._ended.pop()
        if self.registration is not None:
            return self._configure(time, -1 if status is None else status.nav_state)
        if time < max(self._next, self._again) or self._foreign or self._disarmed_only:
            return None
        self._next = time + RETRY_S
        self._requests = [*self._requests[-9:], random.getrandbits(63)]
        return self._requests[-1]

    def on_reply(self, time: float, request_id: int, name: str, api_version: int, success: bool,
                 arming_check_id: int, mode_id: int, armed: bool = False) -> None:
        """Process a reply. Replies to other components are ignored.

        Parameters:
            time (s): arrival, monotonic
            request_id, name, api_version, success, arming_check_id, mode_id: fields of RegisterExtComponentReply
            armed: whether the vehicle is armed
        """
        if request_id not in self._requests or name != MODE_NAME:
            return
        self._requests.remove(request_id)
        granted = Registration(arming_check_id, mode_id, api_version)
        self._foreign = api_version not in self._versions
        usable = success and not self._foreign and mode_id in EXTERNAL_MODES and arming_check_id >= 0
        if success and (self.registration is not None or not usable) and granted != self.registration:
            self._ended.append(granted)
            self._next = min(self._next, time + SETTLE_S)
        if self.registration is not None:
            return
        if usable:
            self.problem, self.registration = '', granted
            self._question_at = time + GRACE_S - LOST_AFTER_S
            self._configured, self._active = 0.0, False
            return
        self._again = time + REFUSED_S
        if self._foreign:
            spoken = ' and '.join(map(str, sorted(self._versions)))
            self.problem = (f'PX4 speaks version {api_version} of the interface for external modes, this rig with the '
                            f'installed px4_msgs {spoken}')
        elif success:
            self.problem = f'PX4 gave mode {mode_id} and check {arming_check_id}, expected a mode of 23 to 30'
        else:
            self._disarmed_only = armed
            self.problem = 'PX4 refused the registration' + (': it is armed' if armed else ', all places may be taken')

    def on_configured(self, mode_id: int, result: int) -> None:
        """Process PX4's reply to a configuration of version 2.

        Parameters:
            mode_id, result: fields of SetpointConfigReply
        """
        if self.registration is not None and mode_id == self.registration.mode_id:
            self._configured = math.inf
            self.problem = '' if result == 0 else f'PX4 refuses position setpoints of an external mode (result {result})'

    def on_question(self, time: float, can_run: bool, valid_mask: int | None = None) -> bool | None:
        """Whether to reply to an arming check that the mode can run; None while no mode is registered.

        Parameters:
            time (s): monotonic
            can_run: whether it can run now, as far as this rig knows
            valid_mask: one bit for each registration that PX4 regards as alive, None before PX4 1.17
        """
        if self.registration is None:
            return None
        number = self.registration.arming_check_id
        valid = valid_mask is None or bool(valid_mask >> number & 1) or self._question_at > time    # or it is the first
        if valid:
            self._question_at = max(self._question_at, time)
        return can_run and valid and not self.problem

    def active_mode(self, time: float) -> int | None:
        """nav_state of the registered mode if the registration is confirmed at `time` (s, monotonic), else None."""
        if self.registration is None or time > self._question_at + LOST_AFTER_S:
            return None
        return self.registration.mode_id

    def forget(self, why: str) -> None:
        """Discard the registration; `why` becomes the reported problem."""
        self.registration, self.problem = None, why

    def _configure(self, time: float, nav_state: int) -> Configure | None:
        """A configuration after the registration and after each selection, until PX4 has confirmed it."""
        registration = self.registration
        if registration is None:
            return None
        active = nav_state == registration.mode_id
        if active and not self._active:
            self._configured, self._configure_at = 0.0, time
        self._active = active
        applies = active or registration.version == 1    # version 2 is applied to the mode that flies
        if not applies or self._configured >= UNCONFIRMED or time < self._configure_at:
            return None
        self._configure_at = time + CONFIGURE_S
        self._configured += registration.version == 1
        return Configure(registration)
