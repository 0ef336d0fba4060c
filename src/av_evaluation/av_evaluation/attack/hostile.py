"""Hostile values for the fields of any message, and mutilated serializations of messages."""

from __future__ import annotations

import math
import re
import struct
import time
from collections.abc import Callable
from importlib import import_module
from random import Random
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time

# Marks pointing commands of the attack: an observer tells them from those of the rig. Never mutilated.
MARK = b'\x07attack\x07'
REALS = (math.nan, math.inf, -math.inf, 0.0, -0.0, -1.0, 1e-300, 1e300, -1e300, 3.4e38, 1e9, -1e9, math.pi, -math.pi, 0.5)
SIZES, FEW = (0, 1, 2, 3, 17, 257), (0, 1, 2, 3, 3, 17)
LENGTHS = (0xFFFFFFFF, 0x7FFFFFFF, 0x80000000, 0x00FFFFFF, 0xFFFF, 0)
TEXTS = ('', 'base_link', 'microphones', 'camera', 'camera_optical', 'map', 'nowhere', '/' * 40, '\u202e\U0001f9e8',
         'x' * 3000)
INTEGER = re.compile(r'(?P<sign>u?)int(?P<bits>\d+)')
ARRAY = re.compile(r'sequence<(?P<item>[^,>]+)(, (?P<most>\d+))?>|(?P<fixed>[^\[]+)\[(?P<count>\d+)\]')
MOST_FLOAT32 = float(np.finfo(np.float32).max)


class HostileValues:
    """Random values that a careless receiver trips over.

    Attributes:
        stale: whether no stamp is within 5 s of now, so that no message looks like a new measurement.

    Parameters:
        random: source of the draws.
        clock: gives the time (s) that stamps are near to.
    """

    def __init__(self, random: Random, clock: Callable[[], float] = time.time) -> None:
        self.random, self._clock = random, clock
        self.stale = False

    def disturb(self, message: Any, share: float) -> None:
        """Replace fields of a message, at any depth, by hostile ones.

        Parameters:
            message: the message, which is changed.
            share (0 to 1): probability for each field.
        """
        for name, kind in message.get_fields_and_field_types().items():
            if kind == 'builtin_interfaces/Time':
                setattr(message, name, self.stamp())
            elif '/' in kind and '<' not in kind and '[' not in kind:
                self.disturb(getattr(message, name), share)
            elif '/' in kind and self.random.random() > share:
                for item in getattr(message, name):
                    self.disturb(item, share)
            elif self.random.random() < share:
                setattr(message, name, self.value(kind))

    def value(self, kind: str) -> Any:
        """A value of a type as `get_fields_and_field_types` names it."""
        if array := ARRAY.fullmatch(kind):
            item = array['item'] or array['fixed']
            if not array['count'] and '/' in item:
                return [self.value(item) for _ in range(self.random.choice(FEW))]
            count = int(array['count']) if array['count'] else min(self.random.choice(SIZES), int(array['most'] or 1 << 30))
            return self.random.choices([self.value(item) for _ in range(3)], k=count)
        if '/' in kind:
            package, name = kind.split('/')
            message = getattr(import_module(f'{package}.msg'), name)()
            self.disturb(message, 0.7)
            return message
        if integer := INTEGER.fullmatch(kind):
            return self.integer(int(integer['bits']), integer['sign'] == 'u')
        scalars: dict[str, Callable[[], Any]] = {
            'double': self.real, 'float': self.real32, 'boolean': lambda: self.random.random() < 0.5,
            'octet': lambda: self.random.randbytes(1)}
        return scalars.get(kind, lambda: self.random.choice(TEXTS))()

    def real(self) -> float:
        """A real number; one in three is of a usual size."""
        return self.random.gauss(0.0, 2.0) if self.random.random() < 0.33 else self.random.choice(REALS)

    def real32(self) -> float:
        """A real number that fits into 32 bits."""
        value = self.real()
        return value if not math.isfinite(value) or abs(value) <= MOST_FLOAT32 else math.copysign(math.inf, value)

    def integer(self, bits: int, unsigned: bool) -> int:
        """An integer, often at an end of its range.

        Parameters:
            bits: its size.
            unsigned: whether it has no sign.
        """
        low, high = (0, 2**bits - 1) if unsigned else (-2**(bits - 1), 2**(bits - 1) - 1)
        return self.random.choice((low, high, 0, 1, high // 2, self.random.randint(low, high), self.random.randint(0, 100)))

    def stamp(self) -> Time:
        """A stamp: of now where `stale` permits, slightly off, or at the ends of its range."""
        off = self.random.choice((0.0, 0.0, -0.1, 0.1, -0.5, -0.9, 2.0, -10.0, 1e3, -1e6) if not self.stale else (-6.0, 6.0))
        off *= 1.0 + (self.random.random() if self.stale else 0.0)
        if self.random.random() < (0.5 if self.stale else 0.3):
            return Time(sec=self.random.choice((0, -1, -2**31, 2**31 - 1, 2**31 - 2, 1, 10**9)),
                        nanosec=self.random.choice((0, 999_999_999, 10**9, 2**32 - 1)))
        seconds, fraction = divmod(self._clock() + off, 1.0)
        return Time(sec=int(seconds), nanosec=int(fraction * 1e9))

    def mutilate(self, data: bytes) -> bytes:
        """A serialized message, damaged: cut, extended, with wrong bits or lengths; MARK stays where it is."""
        kind = self.random.choice(('cut', 'bits', 'bits', 'word', 'word', 'real', 'longer', 'short'))
        if kind == 'short':
            return data[:self.random.choice((0, 4, 4, 5, 8, 12))]
        if kind == 'cut':
            return data[:self.random.randrange(len(data) + 1)]
        if kind == 'longer':
            return data + self.random.randbytes(self.random.choice((1, 4, 1000)))
        return self._damaged(bytearray(data), kind)

    def _damaged(self, data: bytearray, kind: str) -> bytes:
        mark = data.find(MARK)
        for _ in range(self.random.choice((1, 2, 8))):
            # Lengths and magic numbers are near the beginning: half of the damage goes there.
            end = len(data) if self.random.random() < 0.5 else min(len(data), 128)
            place = self.random.randrange(max(end, 1))
            new = {'word': struct.pack('<I', self.random.choice(LENGTHS)), 'real': struct.pack('<d', self.real()),
                   'bits': bytes([self.random.randrange(256)])}[kind]
            place -= place % len(new) if kind != 'bits' else 0
            untouched = mark < 0 or place + len(new) <= mark or place >= mark + len(MARK)
            if untouched and place + len(new) <= len(data):
                data[place:place + len(new)] = new
        return bytes(data)
