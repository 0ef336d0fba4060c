"""The machine: clock, processors, and settings of the middleware."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from av_view.doctor.finding import Finding

LEAST_BUFFER = 2_000_000  # bytes of a socket that hold one large image
LEAST_EPOCH_S = 1.7e9  # of a clock that has been set at all
NETWORK_MODES = ('SUBNET', 'SYSTEM_DEFAULT')


def judge_clock(synchronised: bool | None, now: float) -> Finding:
    """Judge the clock.

    Parameters:
        synchronised: whether the system says that it follows a reference; None where it does not say.
        now (s): its time since the epoch.
    """
    if now < LEAST_EPOCH_S:
        return Finding('clock', 'error', 'the clock has not been set', 'sudo timedatectl set-ntp true, or sudo date -s "..."')
    if synchronised is None:
        return Finding('clock', 'unknown', 'nothing says whether the clock follows a reference',
                       'with several machines: sudo apt-get install chrony')
    if not synchronised:
        return Finding('clock', 'warning', 'the clock follows no reference: several machines and PX4 will disagree',
                       'sudo timedatectl set-ntp true')
    return Finding('clock', 'ok', 'the clock follows a reference')


def judge_detector(milliseconds: float, wanted_rate: float, name: str) -> Finding:
    """Judge the time that the detector takes.

    Parameters:
        milliseconds: median of one image.
        wanted_rate (Hz): images a second that the camera gives.
        name: of the model.
    """
    rate = 1000.0 / milliseconds
    words = f'{name} takes {milliseconds:.0f} ms an image, up to {rate:.1f} images a second'
    if rate < 2.0:
        return Finding('processor', 'error', words, 'a smaller model or input_size of detector_node, or a faster machine')
    if rate < wanted_rate:
        return Finding('processor', 'warning', f'{words}; the camera gives {wanted_rate:.0f}',
                       'the detector skips images: fine for slow targets; else a smaller input_size')
    return Finding('processor', 'ok', words)


def judge_load(load: float, cores: int) -> Finding:
    """Judge what else runs.

    Parameters:
        load: processes that want to run, mean of a minute.
        cores: number of processor cores.
    """
    if load > 0.7 * cores:
        return Finding('processor', 'warning', f'{load:.1f} processes want to run on {cores} cores already',
                       'end what is not needed: top')
    return Finding('processor', 'ok', f'{cores} cores, of which {load:.1f} are busy')


def judge_px4(messages: bool, agent: bool, running: bool, topics: Collection[str]) -> list[Finding]:
    """Judge the link to PX4, from the messages to what arrives.

    Parameters:
        messages: whether px4_msgs is installed.
        agent: whether an agent of uXRCE-DDS is.
        running: whether one runs.
        topics: names of all topics.
    """
    if any('/fmu/out/' in topic for topic in topics):
        found = [Finding('px4', 'ok', 'topics of PX4 arrive; next: docs/guides/px4.md')]
    elif running:
        found = [Finding('px4', 'error', 'the agent runs, and nothing comes from PX4', 'in PX4: uxrce_dds_client status; '
                         'compare port and baud rate of both, and ROS_DOMAIN_ID with UXRCE_DDS_DOM_ID')]
    elif agent:
        found = [Finding('px4', 'error', 'the agent does not run', 'MicroXRCEAgent udp4 -p 8888, or for a serial link: '
                         'MicroXRCEAgent serial --dev /dev/ttyUSB0 -b 921600')]
    else:
        found = [Finding('px4', 'error', 'no agent of uXRCE-DDS is installed', 'sudo snap install micro-xrce-dds-agent '
                         '--edge, or build https://github.com/eProsima/Micro-XRCE-DDS-Agent')]
    if not messages:
        found.insert(0, Finding('px4', 'error', 'px4_msgs is not installed', 'clone https://github.com/PX4/px4_msgs, the '
                                'branch of your firmware, into src, and make build'))
    return found


def judge_middleware(environment: Mapping[str, str], buffer: int | None) -> list[Finding]:
    """Judge the settings of DDS.

    Parameters:
        environment: variables by name.
        buffer: largest buffer of a socket (net.core.rmem_max, bytes); None where it is unknown.
    """
    found = []
    rmw, domain = environment.get('RMW_IMPLEMENTATION', ''), environment.get('ROS_DOMAIN_ID', '0')
    if rmw != 'rmw_cyclonedds_cpp':
        found.append(Finding('middleware', 'warning', f'{rmw or "the default"} loses large images at high rates',
                             'export RMW_IMPLEMENTATION=rmw_cyclonedds_cpp'))
    if not domain.isdigit() or int(domain) > 101:
        found.append(Finding('middleware', 'error', f'ROS_DOMAIN_ID is {domain}, whose ports Linux lends to others',
                             'export ROS_DOMAIN_ID=0, or another up to 101'))
    if environment.get('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET') in NETWORK_MODES:
        found.append(Finding('middleware', 'warning', 'every machine of the network can read and command the rig',
                             'export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, or security:= (docs/guides/security.md)'))
    if buffer is not None and buffer < LEAST_BUFFER:
        found.append(Finding('middleware', 'warning', f'sockets hold {buffer // 1000} kB, less than an image',
                             f'sudo sysctl -w net.core.rmem_max={4 * LEAST_BUFFER}'))
    return found or [Finding('middleware', 'ok', f'{rmw}, domain {domain}')]
