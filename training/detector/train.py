"""Train the drone detector: `python train.py --start YOLOX_NANO --data DRONE_DETECTION --cache FOLDER --out FOLDER`.

Stops and goes on where it stopped; every random number follows from the seed and the step, so that a run can be repeated.
"""

from __future__ import annotations

import argparse
import math
import signal
import time
from contextlib import suppress
from copy import deepcopy
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Event

import numpy as np
import torch
from album import Album
from clips import Frames, build_cache
from loss import loss
from near import NearSampler
from network import Network, cells
from places import SOURCES
from samples import Sampler
from simulated import build_simulated
from sprites import build_bank
from start import start_from, widen
from thermal import BATCHES as THERMAL_BATCHES
from thermal import ThermalFrames, ThermalSampler
from torch import Tensor

# (side of the crops, how many a batch, how often): small windows teach what far things are cheaply, large ones the near
# things and how much in a image is nothing.
Batches = tuple[tuple[int, int, float], ...]
BATCHES: Batches = ((128, 40, 0.2), (256, 14, 0.3), (416, 6, 0.3), (640, 3, 0.2))
NEAR_BATCHES: Batches = ((192, 24, 0.3), (256, 14, 0.4), (320, 9, 0.3))
AnySampler = Sampler | NearSampler | ThermalSampler
WARM_UP, DECAY = 200, 0.5
FROZEN = ('stem', 'dark2', 'dark3')  # of the near network: what COCO taught about edges and textures serves all places


def rate_at(step: int, steps: int, peak: float) -> float:
    """Learning rate: a warm-up, a plateau, and a fall to nothing over the last half (the plateau's end can be moved)."""
    left = (steps - step) / (DECAY * steps)
    return peak * min(1.0, (step + 1) / WARM_UP, max(left, 0.0) ** 1.2)


class Loader:
    """Makes the crops of the next steps in processes of its own while the network learns from the last ones.

    Parameters:
        sampler: what makes a crop.
        batches: (side, crops, share) of the kinds of steps.
        seed: seed of all steps.
        step: the first step.
        workers: number of processes, each of which makes one step in turn.
        times: factor of the number of crops a step.
        device: where the images and labels go.
    """

    def __init__(self, sampler: AnySampler, batches: Batches, seed: int, step: int, workers: int, times: int,
                 device: str) -> None:
        forked = get_context('fork')
        self._device, self._asked = device, []
        for number in range(workers):
            ours, theirs = forked.Pipe()
            self._asked.append(ours)
            # A worker must not keep the trainer's ends open: nobody's asking would never show.
            forked.Process(target=make_crops, args=(list(self._asked), theirs, sampler, batches, seed, times),
                           daemon=True).start()
            theirs.close()
            ours.send(step + number)

    def get(self, step: int) -> tuple[Tensor, list[Tensor]]:
        """Images (n, 3, side, side) RGB in 0-1 and their labels (k, 5) of the next step, whose number this is."""
        worker = self._asked.pop(0)
        images, boxes = worker.recv()
        worker.send(step + len(self._asked) + 1)
        self._asked.append(worker)
        tensor = torch.from_numpy(images).to(self._device).flip(-1).permute(0, 3, 1, 2).float().div_(255.0)
        return tensor.contiguous(memory_format=torch.channels_last), [torch.from_numpy(one).to(self._device) for one in boxes]


def make_crops(asking: list[Connection], answer: Connection, sampler: AnySampler, batches: Batches, seed: int,
               times: int) -> None:
    """For each step asked for: images (n, side, side, 3) BGR and n times labels; ends with the trainer, however that ends."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # a checkpoint is the trainer's to write
    for inherited in asking:
        inherited.close()
    with suppress(EOFError, BrokenPipeError):
        while True:
            rng = np.random.default_rng([seed, answer.recv()])
            side, count, _ = batches[rng.choice(len(batches), p=[share for *_, share in batches])]
            drawn = [sampler.draw(rng, side) for _ in range(times * count)]
            answer.send((np.stack([image for image, _ in drawn]), [boxes for _, boxes in drawn]))


@torch.no_grad()
def follow(average: Network, network: Network, step: int) -> None:
    """Exponential moving average of the weights: it is what is shipped."""
    keep = min(0.998, (1 + step) / (10 + step))
    for mean, new in zip(average.state_dict().values(), network.state_dict().values(), strict=True):
        mean.mul_(keep).add_(new, alpha=1.0 - keep)


def save(path: Path, **state: object) -> None:
    """Write a checkpoint so that an interruption leaves the old one whole."""
    torch.save(state, path.with_suffix('.tmp'))
    path.with_suffix('.tmp').rename(path)


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--data', type=Path, required=True, help='the drone_detection data set')
    parser.add_argument('--cache', type=Path, required=True, help='folder for decoded frames (7 GB) and renders')
    parser.add_argument('--out', type=Path, required=True, help='folder for checkpoints')
    parser.add_argument('--steps', type=int, default=30100, help='steps in all; may be changed when going on')
    parser.add_argument('--start', type=Path, required=True, help='ONNX: YOLOX-nano, trained on COCO, or an exported detector')
    parser.add_argument('--rate', type=float, default=8e-4, help='peak learning rate (AdamW)')
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--threads', type=int, default=2)
    parser.add_argument('--wide', type=int, default=1, help="channels, as a multiple of YOLOX-nano's")
    parser.add_argument('--near', action='store_true', help='train the network of the near pass: pictures of the places alone')
    parser.add_argument('--thermal', action='store_true', help='train the thermal detector: clips and simulated images')
    parser.add_argument('--leave-out', nargs='*', default=[], metavar='PLACE', help='places (places.py) not to be trained on',
                        choices=[*(place.name for place in SOURCES), 'thermal'])
    parser.add_argument('--device', default='cuda' if torch.cuda.is_available() else 'cpu')
    parser.add_argument('--workers', type=int, default=1, help='processes that make crops')
    parser.add_argument('--times', type=int, default=1, help='factor of the crops a step, for accelerators')
    parser.add_argument('--pause-file', type=Path, help='training sleeps while this file exists')
    return parser.parse_args()


def make_sampler(args: argparse.Namespace) -> AnySampler:
    """What makes the crops, from the cache, which is filled first."""
    if args.thermal:
        clips = ThermalFrames(args.data, args.cache, 'train', 'thermal' in args.leave_out)
        return ThermalSampler(clips, ThermalFrames(args.data, args.cache, 'simulated'))
    album = Album(args.cache, tuple(args.leave_out))
    if args.near:
        return NearSampler(album)
    build_cache(args.data, args.cache)
    build_simulated(args.cache / 'simulated')
    simulated = Frames(args.cache / 'simulated', 'train')
    return Sampler(Frames(args.cache, 'train'), build_bank(args.cache, 'train'), simulated, album)


def make_network(args: argparse.Namespace) -> Network:
    """The network with the weights that training starts from."""
    small = Network()
    start_from(small, args.start)
    network = small if args.wide == 1 else Network(times=args.wide)
    if args.wide > 1:
        widen(small, network)
    for name in FROZEN if args.near else ():
        network.get_submodule(name).requires_grad_(False)
    return network


def main() -> None:
    """Entry point."""
    args = arguments()
    torch.set_num_threads(args.threads)
    torch.manual_seed(args.seed)
    sampler = make_sampler(args)
    network = make_network(args).to(args.device, memory_format=torch.channels_last)
    average = deepcopy(network).eval()
    decayed = [p for p in network.parameters() if p[0].numel() > 1]
    plain = [p for p in network.parameters() if p[0].numel() == 1]
    groups = [{'params': decayed, 'weight_decay': 0.02}, {'params': plain, 'weight_decay': 0.0}]
    optimizer = torch.optim.AdamW(groups, lr=args.rate)
    args.out.mkdir(parents=True, exist_ok=True)
    checkpoint, step = args.out / 'checkpoint.pt', 0
    if checkpoint.exists():
        state = torch.load(checkpoint, map_location=args.device)
        network.load_state_dict(state['network'])
        average.load_state_dict(state['average'])
        optimizer.load_state_dict(state['optimizer'])
        step = state['step']
    batches = THERMAL_BATCHES if args.thermal else NEAR_BATCHES if args.near else BATCHES
    loader = Loader(sampler, batches, args.seed, step, args.workers, args.times, args.device)
    last_saved, sums, since, began = time.monotonic(), {}, 0, time.monotonic()
    stopped = Event()
    signal.signal(signal.SIGTERM, lambda *_: stopped.set())
    while step < args.steps and not stopped.is_set():
        while args.pause_file and args.pause_file.exists():
            time.sleep(1.0)
        images, truth = loader.get(step)
        for group in optimizer.param_groups:
            group['lr'] = rate_at(step, args.steps, args.rate)
        with torch.autocast(args.device, torch.bfloat16, enabled=args.device == 'cuda'):
            logits, raw = network(images)
        grid = (one.to(args.device) for one in cells(*images.shape[2:]))
        total, parts = loss(logits.float(), raw.float(), truth, *grid)
        if not math.isfinite(total.item()):
            raise FloatingPointError(f'the loss is {total.item()} at step {step}: lower --rate')
        optimizer.zero_grad(set_to_none=True)
        total.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 10.0)
        optimizer.step()
        follow(average, network, step)
        step += 1
        since += 1
        for name, value in parts.items():
            sums[name] = sums.get(name, 0.0) + value
        if step % 50 == 0:
            means = ' '.join(f'{name} {value / since:.3f}' for name, value in sums.items())
            rate, each = optimizer.param_groups[0]['lr'], (time.monotonic() - began) / since
            print(f'step {step} {means} rate {rate:.5f} {each:.2f} s', flush=True)
            sums, since, began = {}, 0, time.monotonic()
        if time.monotonic() - last_saved > 120 or step == args.steps or stopped.is_set():
            save(checkpoint, network=network.state_dict(), average=average.state_dict(), optimizer=optimizer.state_dict(),
                 step=step, left_out=args.leave_out, wide=args.wide)
            last_saved = time.monotonic()


if __name__ == '__main__':
    main()
