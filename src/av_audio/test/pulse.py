"""A sound card made of software: PulseAudio with a null sink, whose monitor is a real capture device."""

import os
import shutil
import subprocess
import time
from pathlib import Path


class PulseCard:
    """Starts a private PulseAudio server in a folder; PortAudio finds it through ALSA's plugin for PulseAudio."""

    NEEDED = ('pulseaudio', 'pactl', 'paplay')

    def __init__(self, folder: Path, channels: int = 2, rate: int = 48_000) -> None:
        self._folder = folder
        self._channels, self._rate = channels, rate
        self._config = folder / 'asound.conf'
        self._config.write_text('pcm.!default { type pulse }\nctl.!default { type pulse }\n')
        self._server = None
        self._player = None
        os.environ.update(self.environment())

    @classmethod
    def missing(cls) -> str:
        """What has to be installed, '' when nothing."""
        programs = [name for name in cls.NEEDED if not shutil.which(name)]
        plugin = any(Path('/usr/lib').glob('*/alsa-lib/libasound_module_pcm_pulse.so'))
        return ', '.join(programs + ([] if plugin else ['libasound2-plugins']))

    def environment(self) -> dict[str, str]:
        """Variables that lead PulseAudio's clients, PortAudio among them, to this server."""
        return {'PULSE_SERVER': f'unix:{self._folder}/native', 'PULSE_RUNTIME_PATH': str(self._folder),
                'PULSE_STATE_PATH': str(self._folder), 'ALSA_CONFIG_PATH': self._alsa_config(), 'HOME': str(self._folder)}

    def _alsa_config(self) -> str:
        system = Path('/usr/share/alsa/alsa.conf')
        return f'{system}:{self._config}' if system.exists() else str(self._config)

    def plug(self) -> None:
        """Start the server; returns when the card can be captured from."""
        sink = f'module-null-sink sink_name=vmic channels={self._channels} rate={self._rate}'
        self._server = subprocess.Popen(
            ['pulseaudio', '-n', '--daemonize=no', '--exit-idle-time=-1', '--use-pid-file=no', '--system=no',
             '-L', f'module-native-protocol-unix socket={self._folder}/native auth-anonymous=1', '-L', sink],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        end = time.monotonic() + 120.0  # only limits how long a failure takes
        while time.monotonic() < end:
            if self._pactl('set-default-source', 'vmic.monitor') == 0:
                return
            time.sleep(0.1)
        raise RuntimeError('PulseAudio did not start')

    def play(self, path: Path) -> None:
        """Begin to play a file into the sink."""
        self._player = subprocess.Popen(['paplay', '-d', 'vmic', str(path)], stdout=subprocess.DEVNULL,
                                        stderr=subprocess.DEVNULL)

    def unplug(self) -> None:
        """Stop player and server."""
        for process in (self._player, self._server):
            if process is not None and process.poll() is None:
                process.terminate()
                process.wait(10)
        self._player = self._server = None

    @staticmethod
    def _pactl(*arguments: str) -> int:
        return subprocess.run(['pactl', *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                              timeout=60).returncode
