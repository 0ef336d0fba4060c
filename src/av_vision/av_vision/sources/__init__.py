"""Where pictures come from: files, V4L2 devices, RealSense cameras."""

from av_vision.sources.capture import Capture, Picture, Source, SourceError

__all__ = ['Capture', 'Picture', 'Source', 'SourceError']
