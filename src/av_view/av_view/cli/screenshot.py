"""Pictures of the page of a running rig: `ros2 run av_view screenshot --out page.png`."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from av_view.browser import Browser, find_browser


def main() -> None:
    """Write a screenshot. Exits with 1 and a line where there is no browser or no rig."""
    parser = argparse.ArgumentParser(prog='screenshot', description=__doc__)
    parser.add_argument('--address', default='http://127.0.0.1:8780/', help='address of the page')
    parser.add_argument('--out', type=Path, default=Path('page.png'), help='PNG or JPEG file to write')
    parser.add_argument('--size', type=int, nargs=2, default=(1400, 1000), metavar=('WIDTH', 'HEIGHT'),
                        help='of the page, pixels')
    parser.add_argument('--light', action='store_true', help='light instead of dark')
    parser.add_argument('--rig', default='', help='namespace of the rig to show')
    parser.add_argument('--after', type=float, default=10.0, help='time to watch before (s)')
    options = parser.parse_args()
    program = find_browser()
    if not program:
        sys.exit('screenshot: no Chromium is installed: sudo apt-get install chromium')
    width, height = options.size
    with Browser(program, width, height, dark=not options.light) as browser:
        browser.open(options.address)
        if not browser.wait_for('typeof state === "object" && state !== null'):
            sys.exit(f'screenshot: no rig answers at {options.address}: start it with view:=true')
        if options.rig:
            browser.value(f'$("rigs").value = {options.rig!r}, $("rigs").onchange()')
        time.sleep(options.after)
        browser.screenshot(options.out)
    print(options.out)
