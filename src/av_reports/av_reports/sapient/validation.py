"""What the standard demands of every message, from the options of its protobuf files: mandatory fields, ULIDs, UUIDs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from itertools import islice
from typing import Any

from google.protobuf.descriptor import FieldDescriptor

from av_reports.identifiers import is_ulid, is_uuid
from av_reports.sapient.protocol import SapientMessage, options

MOST_FAULTS = 20  # more are not looked for
MOST_VALUES = 2000  # in one message; a registration of this suite has some 150
FIELD, ONEOF = options.field_options, options.oneof_options
REALS = (FieldDescriptor.TYPE_FLOAT, FieldDescriptor.TYPE_DOUBLE)


def parse(data: bytes) -> Any:
    """The SapientMessage of its bytes. Raises ValueError that names what is wrong.

    Parameters:
        data: a message without its length.
    """
    message = SapientMessage()
    try:
        message.ParseFromString(data)
    except Exception as error:
        raise ValueError(f'{len(data)} bytes are no message of SAPIENT: {error}') from error
    check(message)
    return message


def check(message: Any) -> None:
    """Raise ValueError that names the faults of a message of SAPIENT."""
    if found := list(islice(faults(message), MOST_FAULTS)):
        raise ValueError('; '.join(found))


def faults(message: Any, path: str = '', budget: Iterator[int] | None = None) -> Iterator[str]:
    """Faults of a message and of all in it, by the options of its fields.

    Parameters:
        message: any message of SAPIENT.
        path: name of the field that holds it, with a dot at its end; empty for the outermost.
        budget: one element for each value that may still be looked at; None for MOST_VALUES.
    """
    budget = iter(range(MOST_VALUES)) if budget is None else budget
    present = {field.name: value for field, value in message.ListFields()}
    for oneof in message.DESCRIPTOR.oneofs:
        if oneof.GetOptions().Extensions[ONEOF].is_mandatory and message.WhichOneof(oneof.name) is None:
            yield f'{path}{oneof.name} is missing'
    for field in message.DESCRIPTOR.fields:
        if field.name not in present:
            if _needed(field):
                yield f'{path}{field.name} is missing'
            continue
        value = present[field.name]
        for element in value if hasattr(value, 'extend') else (value,):  # a repeated field, in every version of protobuf
            if next(budget, None) is None:
                yield f'{path}{field.name}: more than {MOST_VALUES} values'
                return
            yield from _value_faults(field, element, f'{path}{field.name}', budget)


def _needed(field: Any) -> bool:
    """Whether a field is mandatory. An `optional` one of proto3 is in a oneof of its own."""
    alone = field.containing_oneof is None or field.containing_oneof.name == f'_{field.name}'
    return alone and field.GetOptions().Extensions[FIELD].is_mandatory


@cache
def _defined(enumeration: Any) -> frozenset[int]:
    """Values of an enumeration but for 0, which is always `unspecified`."""
    return frozenset(enumeration.values_by_number) - {0}


def _value_faults(field: Any, value: Any, name: str, budget: Iterator[int]) -> Iterator[str]:
    rules = field.GetOptions().Extensions[FIELD]
    if field.type == FieldDescriptor.TYPE_MESSAGE:
        if value.DESCRIPTOR.file.package.startswith('sapient_msg'):
            yield from faults(value, f'{name}.', budget)
    elif rules.is_ulid and not is_ulid(value):
        yield f'{name} is {value!r:.50}, expected a ULID'
    elif rules.is_uuid and not is_uuid(value):
        yield f'{name} is {value!r:.50}, expected a UUID'
    elif field.type == FieldDescriptor.TYPE_ENUM and rules.is_mandatory and value not in _defined(field.enum_type):
        yield f'{name} is {value}, expected a value that the standard defines'
    elif field.type in REALS and not math.isfinite(value):
        yield f'{name} is {value}, expected a finite number'
