"""What viewers of a rig see, for Foxglove: pictures, boxes on them, and the state, by the optional package `foxglove-sdk`."""

from __future__ import annotations

import math
from importlib import import_module
from typing import Any, NamedTuple

from av_view.picture import Picture

GREEN, BLUE = (0.31, 0.86, 0.24, 1.0), (0.43, 0.7, 0.95, 1.0)  # of detections, of the bearing
LINE, FONT = 2.0, 16.0  # pixels
# Named, and with fields, as a bag of the rig has them, so that one layout fits both; boxes and lines are the port's own.
PICTURE, BEARING, DOA, STATE = '/camera/image_raw/compressed', '/target/bearing', '/doa', '/fusion/state'
ANNOTATIONS, SNAPSHOT = '/view/annotations', '/view/state'
MODULES = ('foxglove', 'foxglove.channels', 'foxglove.messages')


class Shown(NamedTuple):
    """What viewers see of a rig.

    Parameters:
        snapshot: of `RigState`.
        picture: the newest one; None where there is none.
    """

    snapshot: dict[str, Any]
    picture: Picture | None


def tables(snapshot: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """What a snapshot says, by topic: in rad, with the fields of the rig's messages that layouts plot.

    Parameters:
        snapshot: of `RigState`.
    """
    seconds = snapshot['time']
    header = {'header': {'stamp': {'sec': int(seconds), 'nsec': int(1e9 * (seconds % 1.0))}}}
    found = {SNAPSHOT: snapshot}
    bearing, sound, fusion = snapshot['bearing'], snapshot['sound'], snapshot['fusion']
    if bearing is not None and bearing['azimuth'] is not None:
        found[BEARING] = {**header, 'azimuth': math.radians(bearing['azimuth']), 'state': bearing['state']}
    if sound is not None:
        images = [image['azimuth'] for group in sound['groups'] for image in group['images']]
        found[DOA] = {**header, 'hypotheses': [{'azimuth': math.radians(azimuth)} for azimuth in images if azimuth is not None]}
    if fusion is not None:
        found[STATE] = {**header, **fusion}
    return found


class FoxglovePort:
    """A WebSocket of Foxglove: the picture with annotations, bearing, directions and state as JSON, and the whole snapshot.

    Attributes:
        port: TCP port.

    Parameters:
        host: address of this machine to listen at.
        port: TCP port; 0 for one that is free.

    Raises ImportError without `foxglove-sdk`, RuntimeError where the address cannot be bound.
    """

    def __init__(self, host: str, port: int) -> None:
        try:
            foxglove, *_ = map(import_module, MODULES)
        except ImportError as error:
            raise ImportError(f'foxglove_port needs a Python package: pip install foxglove-sdk ({error})') from error
        self._foxglove = foxglove
        self._context = context = foxglove.Context()  # ends its channels when it goes
        self._server = foxglove.start_server(name='rig', host=host, port=port, context=context)
        self.port = int(self._server.port)
        self._pictures = foxglove.channels.CompressedImageChannel(PICTURE, context=context)
        self._annotations = foxglove.channels.ImageAnnotationsChannel(ANNOTATIONS, context=context)
        self._newest: Picture | None = None
        self._tables = {topic: foxglove.Channel(topic, context=context) for topic in (BEARING, DOA, STATE, SNAPSHOT)}

    @property
    def watched(self) -> bool:
        """Whether somebody has subscribed."""
        return any(channel.has_sinks() for channel in (self._pictures, self._annotations, *self._tables.values()))

    def put(self, shown: Shown) -> None:
        """Send a state, with its boxes and its bearing as annotations of the picture, and the picture where it is new."""
        snapshot, picture = shown
        if picture is not None and picture is not self._newest:
            self._newest = picture
            self._pictures.log(self._foxglove.messages.CompressedImage(
                timestamp=self._time(picture.time), frame_id='camera', data=picture.data, format='jpeg'))
        width, height = (picture.width, picture.height) if picture is not None else (1, 1)
        messages = self._foxglove.messages
        time = self._time(snapshot['time'])
        lines, texts = [], []
        drawn = snapshot['picture'] or {'boxes': (), 'line': ()}
        for box in drawn['boxes']:
            if None not in (box['x'], box['y'], box['width'], box['height']):
                x, y, right, low = box['x'], box['y'], box['x'] + box['width'], box['y'] + box['height']
                corners = [[x, y], [right, y], [right, low], [x, low]]
                lines.append(self._line(messages.PointsAnnotationType.LineLoop, corners, GREEN, width, height))
                texts.append(messages.TextAnnotation(
                    position=messages.Point2(x=x * width, y=y * height), text=f'{box["name"]} {box["score"] or 0.0:.2f}',
                    font_size=FONT, text_color=messages.Color(r=1.0, g=1.0, b=1.0, a=1.0)))
        if drawn['line']:
            strip = messages.PointsAnnotationType.LineStrip
            lines.append(self._line(strip, drawn['line'], BLUE, width, height))
        self._annotations.log(messages.ImageAnnotations(timestamp=time, points=lines, texts=texts))
        for topic, content in tables(snapshot).items():
            self._tables[topic].log(content)

    def close(self) -> None:
        """End all connections."""
        self._server.stop()

    def _time(self, seconds: float) -> Any:
        return self._foxglove.messages.Timestamp(int(seconds), int(1e9 * (seconds % 1.0)))

    def _line(self, kind: Any, points: list[list[float]], color: tuple[float, float, float, float], width: int,
              height: int) -> Any:
        messages = self._foxglove.messages
        red, green, blue, alpha = color
        return messages.PointsAnnotation(
            type=kind, points=[messages.Point2(x=x * width, y=y * height) for x, y in points], thickness=LINE,
            outline_color=messages.Color(r=red, g=green, b=blue, a=alpha))
