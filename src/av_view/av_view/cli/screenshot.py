"""Pictures of the page of a running rig, or of one that is started for it: `ros2 run av_view screenshot --out page.png`."""

from __future__ import annotations

import argparse
import sys
import time
from contextlib import ExitStack
from pathlib import Path

from av_view.browser import Browser, find_browser
from av_view.launched_rig import START_S, launched_rig


def main() -> None:
    """Write a screenshot. Exits with 1 and a line where there is no browser or no rig."""
    parser = argparse.ArgumentParser(prog='screenshot', description=__doc__)
    parser.add_argument('--address', default='http://127.0.0.1:8780/', help='address of the page')
    parser.add_argument('--out', type=Path, default=Path('page.png'), help='PNG or JPEG file to write')
    parser.add_argument('--size', type=int, nargs=2, default=(1440, 900), metavar=('WIDTH', 'HEIGHT'),
                        help='of the page, pixels')
    parser.add_argument('--light', action='store_true', help='light instead of dark')
    parser.add_argument('--rig', default='', help='namespace of the rig to show')
    parser.add_argument('--after', type=float, default=10.0, help='time to watch before (s)')
    parser.add_argument('--when', default='true', metavar='EXPRESSION',
                        help='JavaScript to wait for after that, such as state.picture?.boxes.length')
    parser.add_argument('--whole', action='store_true', help='also what is below the window')
    parser.add_argument('--launch', nargs='*', metavar='ARGUMENT',
                        help='start a rig, as `ros2 launch av_fusion rig.launch.py ARGUMENTS`; another launch file goes before')
    options = parser.parse_args()
    program = find_browser()
    if not program:
        sys.exit('screenshot: no Chromium is installed: sudo apt-get install chromium')
    width, height = options.size
    with ExitStack() as stack:
        if options.launch is not None:
            stack.enter_context(launched_rig(options.launch, options.address))
        browser = stack.enter_context(Browser(program, width, height, dark=not options.light))
        browser.open(options.address)
        if not browser.wait_for('typeof socket === "object" && socket.readyState === 1 && state !== null', START_S):
            sys.exit(f'screenshot: no rig answers at {options.address}: start it with view:=true')
        if options.rig:
            if not browser.wait_for(f'[...$("rigs").options].some(one => one.value === {options.rig!r})', START_S):
                sys.exit(f'screenshot: no rig has the namespace {options.rig}')
            browser.value(f'$("rigs").value = {options.rig!r}, $("rigs").onchange()')
        time.sleep(options.after)
        browser.wait_for(options.when, START_S)
        browser.screenshot(options.out, options.whole)
    print(options.out)
