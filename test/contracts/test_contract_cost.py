"""What a window costs, in calls of Python functions: a figure that does not depend on the machine."""

from __future__ import annotations

import sys

from figures import at_most
from formula_rig import Source
from judged_rig import FormulaRig


def test_a_window_of_one_target_is_few_calls(contract):
    """Directions of a pair, one target whose side is known: mean of twenty windows, with the output of each.

    Fields of messages, each of which is a call too, do not count, nor what their checks of types import.
    """
    rig, calls, windows = FormulaRig([Source.at(20.0, 5.0)], sight=lambda t: t < 2.0), [0], [0]
    rig.run(4.0)
    take = rig.stage.on_doa

    def count(frame, event, _argument):
        inside = '/msg/' in frame.f_code.co_filename or '/msg/' in frame.f_back.f_code.co_filename
        calls[0] += event == 'call' and not inside

    def counted(message, arrival):
        windows[0] += 1
        sys.setprofile(count)
        try:
            return take(message, arrival)
        finally:
            sys.setprofile(None)
    rig.stage.on_doa = counted
    rig.run(2.0)
    contract(at_most('calls of a window', calls[0] / windows[0], 400.0))
