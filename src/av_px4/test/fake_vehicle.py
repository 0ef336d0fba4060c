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


class FakeVehicle:
    """Starts the fake autopilot; `tell` sends it orders, `wait` waits for a state."""

    def __init__(self, firmware='1.16', *options, domain=None, namespace='', px4_msgs=None):
        self.firmware, self.namespace = firmware, namespace
        self.environment = {**os.environ, **overlay(px4_msgs or firmware), 'ROS_DOMAIN_ID': str(domain or free_domain())}
        options = (*options, *(('--namespace', namespace) if namespace else ()))
        self.state, self._lines = {}, []
        self._process = subprocess.Popen([sys.executable, str(FAKE), firmware, *options], stdin=subprocess.PIPE,
                                         stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=self.environment)
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
        self._process.stdin.write(json.dumps(order) + '\n')
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
