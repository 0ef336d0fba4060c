"""Sources of images: files, V4L2 devices, RealSense cameras."""

from av_vision.sources.capture import Capture, CapturedImage, Source, SourceError

__all__ = ['Capture', 'CapturedImage', 'Source', 'SourceError']
