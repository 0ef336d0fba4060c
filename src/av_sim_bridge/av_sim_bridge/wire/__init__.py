"""Encoders and decoders of the datagrams that simulators send and accept: one module for each stream, without sockets.

All layouts are little-endian and RFlySim's, except where a module states that a layout is specific to this project.
Positions and attitudes are in the sender's NED/FRD; `av_sim_bridge.vehicle` converts them to ENU/FLU.
"""

from av_sim_bridge.wire.error import ForeignSenderError, UndatedError, WireError

__all__ = ['ForeignSenderError', 'UndatedError', 'WireError']
