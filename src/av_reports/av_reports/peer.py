"""Addresses of peers."""

from __future__ import annotations

import re


def parse_peer(text: str) -> tuple[str, int]:
    """Host and port of `host:port` or `[address]:port`. Raises ValueError for anything else."""
    match = re.fullmatch(r'\[?([^\s\[\]]+?)\]?:(\d{1,5})', text)
    if not match or not 0 < int(match[2]) < 65536:
        raise ValueError(f'peer is {text!r:.80}, expected host:port such as 192.168.1.5:5020')
    return match[1], int(match[2])
