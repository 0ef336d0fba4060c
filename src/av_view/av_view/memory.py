"""How a process that handles pictures, many times a second and for long, keeps its memory."""

from __future__ import annotations

import ctypes
import gc
from functools import cache

RARE_COLLECTIONS = 20_000  # objects that are left before garbage is looked for; reference counts free almost all
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of malloc.h
LARGEST_KEPT = 8 << 20  # bytes of one picture


@cache
def settle() -> None:
    """Keep what is there now out of collections, and freed memory for the next picture; to be called after imports.

    glibc would give the memory of each picture back, and its page faults would cost a quarter of all processor time.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(RARE_COLLECTIONS)
    set_option = getattr(ctypes.CDLL(None), 'mallopt', None)
    if set_option is not None:
        set_option(M_MMAP_THRESHOLD, LARGEST_KEPT)
        set_option(M_TRIM_THRESHOLD, 4 * LARGEST_KEPT)
