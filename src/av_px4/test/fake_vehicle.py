"""The fake autopilot and this package's node as processes of a test."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

from px4_layouts import overlay
from ros_domains import free_domain

FAKE = Path(__file__).with_name('fake_autopilot_node.py')


STAND_INS = {
    'make': 'test "$*" = "px4_sitl sihsim_quadx" && exec {fake}',
    'build/px4_sitl_default/bin/px4':
        'test "$PX4_SIM_MODEL $1" = "sihsim_quadx -i" && exec {fake} --namespace px4_$2 --system $(($2 + 1))',
    'build/px4_sitl_default/bin/px4-commander': 'test "$1" = --instance && echo "$2 commander ${{*:3}}"'}


def stand_ins(folder, firmware):
    """Programs of PX4, by the names and arguments of the tutorials; vehicles wait on the ground for a takeoff.

    What px4-commander is told it prints, with the number of the instance.
    """
    fake = f'{sys.executable} {FAKE} {firmware} --parameters "$PX4_PARAM_MNT_MODE_IN"'
    for name, line in STAND_INS.items():
        program = folder / name
        program.parent.mkdir(parents=True, exist_ok=True)
        program.write_text(f'#!/usr/bin/env bash\n{line.format(fake=fake)}\n')
        program.chmod(0o755)
    return folder


class FakeVehicle:
    """Starts the fake autopilot; `tell` sends it orders, `wait` waits for a state.

    typed: the command that starts it, instead, in a folder of `stand_ins`, which also come first in PATH.
    """

    def __init__(self, firmware='1.16', *options, domain=None, namespace='', typed='', folder=None):
        self.firmware, self.namespace = firmware, namespace
        self.environment = {**os.environ, **overlay(firmware), 'ROS_DOMAIN_ID': str(domain or free_domain())}
        options = (*options, *(('--namespace', namespace) if namespace else ()))
        command = ['bash', '-c', f'exec env {typed}'] if typed else [sys.executable, str(FAKE), firmware, *options]
        path = {'PATH': f'{folder}:{os.environ["PATH"]}'} if folder else {}
        self.state = {}
        pipes = dict.fromkeys(('stdin', 'stdout', 'stderr'), subprocess.PIPE)
        self._process = subprocess.Popen(command, **pipes, text=True, env=self.environment | path, cwd=folder)
        threading.Thread(target=self._read, daemon=True).start()
        self._nodes = []

    def _read(self):
        for line in self._process.stdout:
            if line.startswith('{'):
                self.state = json.loads(line)

    def node(self, environment=None, **parameters):
        """Start px4_node, with further variables in its environment; returns its process."""
        arguments = [part for name, value in parameters.items() for part in ('-p', f'{name}:={value}')]
        arguments += ['-r', f'__ns:=/{self.namespace}'] if self.namespace else []
        command = [sys.executable, '-c', 'from av_px4.nodes.px4_node import main; main()', '--ros-args', *arguments]
        process = subprocess.Popen(command, env={**self.environment, **(environment or {})}, stdout=subprocess.PIPE,
                                   stderr=subprocess.STDOUT, text=True)
        self._nodes.append(process)
        return process

    def tell(self, **order):
        self.type(json.dumps(order))

    def type(self, line):
        """A line in PX4's shell."""
        self._process.stdin.write(line + '\n')
        self._process.stdin.flush()

    def wait(self, condition, seconds=20.0, why=''):
        """Until the state fulfils a condition. Raises AssertionError with the state when it does not."""
        deadline = time.monotonic() + seconds
        while not (self.state and condition(self.state)):
            assert self._process.poll() is None, self._process.stderr.read()
            for node in self._nodes:
                assert node.poll() is None, node.stdout.read()
            assert time.monotonic() < deadline, f'{why or "not fulfilled"}: {self.state}'
            time.sleep(0.02)
        return self.state

    def stop_node(self, process, seconds=30.0):
        """Ctrl-C; returns what it printed."""
        self._nodes.remove(process)
        process.send_signal(signal.SIGINT)
        return process.communicate(timeout=seconds)[0]

    def kill_node(self, process):
        """End it without its knowledge."""
        self._nodes.remove(process)
        process.kill()
        process.communicate()

    def close(self):
        for process in (*self._nodes, self._process):
            process.kill()
            process.wait()
            for pipe in (process.stdin, process.stdout, process.stderr):
                if pipe:
                    pipe.close()
