"""Pictures of the page for the documents: `python3 tools/docs/screenshot.py --out page.png` of a running rig; needs Chromium.

With --launch a rig is started for the picture, as for docs/images/view.jpg:
--launch scenario:=circle oracle:=true renderer:=scene view_control:=true --after 40 --when 'state.picture?.boxes.length'
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / 'src/av_view/test'))
from browser import Browser, find_browser

START_S, END_S = 120.0, 30.0  # longest time for a launch to start and to end


@contextmanager
def launched_rig(words: Sequence[str]) -> Iterator[None]:
    """A launch with `view:=true`: arguments of rig.launch.py, or the name of another launch file and its arguments."""
    file, arguments = (words[0], words[1:]) if words and words[0].endswith('.launch.py') else ('rig.launch.py', words)
    rig = subprocess.Popen(['ros2', 'launch', 'av_fusion', file, 'view:=true', *arguments], stdout=subprocess.DEVNULL)
    try:
        yield
    finally:
        rig.send_signal(signal.SIGINT)
        rig.wait(END_S)


def main() -> None:
    """Write a screenshot. Exits with 1 and a line where there is no browser or no rig."""
    parser = argparse.ArgumentParser(prog='screenshot', description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--address', default='http://127.0.0.1:8780/', help='address of the page')
    parser.add_argument('--out', type=Path, default=Path('page.png'), help='PNG or JPEG file to write')
    parser.add_argument('--size', type=int, nargs=2, default=(1440, 900), metavar=('WIDTH', 'HEIGHT'), help='in pixels')
    parser.add_argument('--light', action='store_true', help='light instead of dark')
    parser.add_argument('--rig', default='', help='namespace of the rig to show')
    parser.add_argument('--after', type=float, default=10.0, help='time to watch before (s)')
    parser.add_argument('--when', default='true', metavar='EXPRESSION', help='JavaScript to wait for after that')
    parser.add_argument('--launch', nargs='*', metavar='ARGUMENT', help='start a rig, see above')
    options = parser.parse_args()
    program = find_browser()
    if not program:
        sys.exit('screenshot: no Chromium is installed: sudo apt-get install chromium')
    width, height = options.size
    with ExitStack() as stack:
        if options.launch is not None:
            stack.enter_context(launched_rig(options.launch))
        browser = stack.enter_context(Browser(program, width, height, dark=not options.light))
        deadline = time.monotonic() + START_S
        while True:
            browser.open(options.address)
            if browser.wait_for('typeof socket === "object" && socket.readyState === 1 && state !== null', 10.0):
                break
            if time.monotonic() > deadline:
                sys.exit(f'screenshot: no rig answers at {options.address}: start it with view:=true')
        if options.rig:
            if not browser.wait_for(f'[...$("rigs").options].some(one => one.value === {options.rig!r})', START_S):
                sys.exit(f'screenshot: no rig has the namespace {options.rig}')
            browser.value(f'$("rigs").value = {options.rig!r}, $("rigs").onchange()')
        time.sleep(options.after)
        browser.wait_for(options.when, START_S)
        browser.screenshot(options.out)
    print(options.out)


if __name__ == '__main__':
    main()
