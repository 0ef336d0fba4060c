"""The datagrams that simulators send and accept: one module per stream, each a pure codec without sockets.

All layouts are little-endian and those of RFlySim, except where a module says that a layout is this project's own.
Positions and attitudes stay in the sender's NED/FRD here; `av_sim_bridge.vehicle` turns them into ENU/FLU.
"""

from av_sim_bridge.wire.error import WireError

__all__ = ['WireError']
