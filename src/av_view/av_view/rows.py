"""The rows of diagrams against time."""

from __future__ import annotations

from typing import Any

# What the columns of a row are; azimuths in degrees, confidences 0..1, delay in s, SNR in dB.
COLUMNS = ('time', 'sound', 'mirror', 'sight', 'fused', 'sigma', 'truth', 'sound_confidence', 'sight_confidence', 'state',
           'delay', 'snr')


def row_of(snapshot: dict[str, Any]) -> list[float | str | None]:
    """The values of COLUMNS in a snapshot, for diagrams against time."""
    bearing, sound, sight, truth = (snapshot[name] for name in ('bearing', 'sound', 'sight', 'truth'))
    azimuths = [image['azimuth'] for group in (sound['groups'][:1] if sound else ()) for image in group['images']]
    boxes = [box for box in sight['boxes'] if None not in (box['azimuth'], box['score'])] if sight else []
    best = max(boxes, key=lambda box: box['score'], default={'azimuth': None, 'score': 0.0})
    known = bearing is not None and bearing['state'] != 'none'
    return [snapshot['time'], *[*azimuths, None, None][:2], best['azimuth'], *([bearing['azimuth'], bearing['sigma']] if known
            else [None, None]), truth[0]['azimuth'] if truth else None, sound and sound['confidence'], best['score'],
            bearing['state'] if bearing else 'none', snapshot['delay'], snapshot['snr']]
