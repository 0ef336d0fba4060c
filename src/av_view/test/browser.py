"""A headless Chromium that is driven by its DevTools protocol, for screenshots and tests."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any

from websockets.sync.client import ClientConnection, connect

PROGRAMS = ('chromium', 'chromium-browser', 'google-chrome')
# Nothing but what the page asks for: no updates, no first run, no synchronisation; names of hosts lead nowhere.
FLAGS = ('--headless', '--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run', '--disable-background-networking',
         '--disable-component-update', '--disable-sync', '--hide-scrollbars', '--remote-debugging-port=0',
         '--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE localhost, EXCLUDE 127.0.0.1')
START_S, ANSWER_S = 60.0, 30.0


def find_browser() -> str:
    """Path of an installed Chromium; empty without one."""
    return next(filter(None, map(shutil.which, PROGRAMS)), '')


class Browser:
    """One tab of a headless Chromium with an empty profile; a context manager.

    Attributes:
        requests: addresses that the page has asked for.

    Parameters:
        program: the browser's path.
        width, height (pixels): size of the page.
        dark: whether the page shall be dark.
        scale: pixels of the screen to one of the page.
    """

    def __init__(self, program: str, width: int = 1400, height: int = 900, dark: bool = True, scale: float = 1.0) -> None:
        self.requests: list[str] = []
        self._number = 0
        self._connections = ExitStack()
        self._folder = tempfile.TemporaryDirectory(prefix='av_view_browser_', ignore_cleanup_errors=True)
        self._process = subprocess.Popen([program, *FLAGS, f'--user-data-dir={self._folder.name}', 'about:blank'],
                                         stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            self._socket = self._connect()
            for domain in ('Page', 'Network', 'Runtime'):
                self.command(f'{domain}.enable')
            self.command('Emulation.setDeviceMetricsOverride', width=width, height=height, deviceScaleFactor=scale,
                         mobile=width < 600)
            scheme = {'name': 'prefers-color-scheme', 'value': 'dark' if dark else 'light'}
            self.command('Emulation.setEmulatedMedia', features=[scheme])
        except BaseException:
            self._end()
            raise

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._end()

    def command(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The result of a command of the DevTools protocol. Raises RuntimeError where it fails.

        Parameters:
            method: such as 'Page.navigate'.
            parameters: of the command.
        """
        self._number += 1
        self._socket.send(json.dumps({'id': self._number, 'method': method, 'params': parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=ANSWER_S))
            self._note(message)
            if message.get('id') == self._number:
                if 'error' in message:
                    raise RuntimeError(f'{method}: {message["error"]}')
                return dict(message['result'])

    def open(self, address: str) -> None:
        """Go to an address."""
        self.command('Page.navigate', url=address)

    def value(self, expression: str) -> Any:
        """The value of a JavaScript expression, which JSON can hold. Raises RuntimeError where it throws."""
        result = self.command('Runtime.evaluate', expression=expression, returnByValue=True, awaitPromise=True)
        if 'exceptionDetails' in result:
            raise RuntimeError(f'{expression}: {result["exceptionDetails"]}')
        return result['result'].get('value')

    def wait_for(self, expression: str, timeout: float = 30.0) -> bool:
        """Whether a JavaScript expression becomes true.

        Parameters:
            expression: the condition.
            timeout (s): time to wait.
        """
        deadline = time.monotonic() + timeout
        while not self.value(f'Boolean({expression})'):
            if time.monotonic() > deadline:
                return False
            time.sleep(0.1)
        return True

    def screenshot(self, file: Path) -> None:
        """Write a picture of the page to a PNG or JPEG file, by its ending."""
        kind = {'format': 'jpeg', 'quality': 75} if file.suffix in ('.jpg', '.jpeg') else {'format': 'png'}
        file.write_bytes(base64.b64decode(self.command('Page.captureScreenshot', **kind)['data']))

    def _note(self, message: dict[str, Any]) -> None:
        parameters = message.get('params', {})
        if message.get('method') == 'Network.requestWillBeSent':
            self.requests.append(parameters['request']['url'])
        elif message.get('method') == 'Network.webSocketCreated':
            self.requests.append(parameters['url'])

    def _connect(self) -> ClientConnection:
        """The connection to the first tab. Raises TimeoutError where the browser does not start."""
        port_file, deadline = Path(self._folder.name, 'DevToolsActivePort'), time.monotonic() + START_S
        while not (port_file.exists() and port_file.read_text().count('\n')):
            if time.monotonic() > deadline or self._process.poll() is not None:
                raise TimeoutError('the browser does not start')
            time.sleep(0.1)
        port, path = port_file.read_text().splitlines()[:2]
        with connect(f'ws://127.0.0.1:{port}{path}', max_size=None, proxy=None) as browser:
            browser.send(json.dumps({'id': 1, 'method': 'Target.getTargets'}))
            targets = json.loads(browser.recv(timeout=ANSWER_S))['result']['targetInfos']
        tab = next(target['targetId'] for target in targets if target['type'] == 'page')
        # Without pings: events that nobody reads for a while would hold up their answers.
        page = connect(f'ws://127.0.0.1:{port}/devtools/page/{tab}', max_size=None, proxy=None, ping_interval=None)
        return self._connections.enter_context(page)

    def _end(self) -> None:
        self._connections.close()
        self._process.terminate()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()
