"""Requests of viewers, without a rig."""

from __future__ import annotations

import asyncio

import pytest

from av_view.nodes import rig_control
from av_view.nodes.rig_control import BagFolder, RigControl


def test_what_a_person_was_told_has_no_answer_is_not_begun_later(tmp_path, monkeypatch):
    """The thread of the node was busy for longer: a stop or a start of motion must not come as a surprise."""
    monkeypatch.setattr(rig_control, 'TIMEOUT_S', 0.05)
    bags, begun = BagFolder(str(tmp_path)), []
    monkeypatch.setattr(bags, 'names', lambda: begun.append('bags') or [])
    control = RigControl(None, bags)
    with pytest.raises(TimeoutError):
        asyncio.run(control.act('bags', '', {}))
    control.work()
    assert begun == []
