"""A YOLO network in an ONNX file, with its input size, layout and class names."""

from __future__ import annotations

import ast
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from av_common.files import check_file, nearest, one_line, shown
from av_vision.yolo.layout import joined, recognise
from av_vision.yolo.letterbox import LETTERBOX_GREY, to_tensor
from av_vision.yolo.rows import Decoded, LayoutError

MOST_BYTES = 500_000_000    # of a file; that of the largest YOLO, v8x with 68 million weights, has 273 MB
MOST_MEMORY = 2_000_000_000    # bytes for an image on its way through the network
LONGEST = 8192                 # pixels of a side of the input
FLOATS = {'tensor(float)': np.float32, 'tensor(float16)': np.float16}
COCO = tuple("""
person|bicycle|car|motorcycle|airplane|bus|train|truck|boat|traffic light|fire hydrant|stop sign|parking meter|bench|bird|cat
dog|horse|sheep|cow|elephant|bear|zebra|giraffe|backpack|umbrella|handbag|tie|suitcase|frisbee|skis|snowboard|sports ball|kite
baseball bat|baseball glove|skateboard|surfboard|tennis racket|bottle|wine glass|cup|fork|knife|spoon|bowl|banana|apple|sandwich
orange|broccoli|carrot|hot dog|pizza|donut|cake|chair|couch|potted plant|bed|dining table|toilet|tv|laptop|mouse|remote|keyboard
cell phone|microwave|oven|toaster|sink|refrigerator|book|clock|vase|scissors|teddy bear|hair drier|toothbrush
""".strip().replace('\n', '|').split('|'))


class ModelError(ValueError):
    """A model cannot be used; the message names the reason."""


@dataclass(frozen=True)
class DetectorSettings:
    """Options of a detector. Raises ValueError for a value outside its bounds.

    Parameters:
        score_threshold (0-1): least score of a detection; 0 uses `score_threshold` of the model's metadata, or 0.25.
        keep: names of the detections to report, after renaming; empty for all.
        rename: new names of classes of the model.
        class_names: names of the model's classes in its order; empty uses the metadata.
        input_size (pixels): longer side for models with dynamic input; 0 uses the size of the metadata.
        providers: execution providers of onnxruntime in order of preference.
        threads: number of threads for one image; 0 uses the default of onnxruntime.
    """

    score_threshold: float = 0.0
    keep: tuple[str, ...] = ()
    rename: dict[str, str] = field(default_factory=dict)
    class_names: tuple[str, ...] = ()
    input_size: int = 0
    providers: tuple[str, ...] = ('CPUExecutionProvider',)
    threads: int = 0

    def __post_init__(self) -> None:
        if not 0.0 <= self.score_threshold <= 1.0:
            raise ValueError(f'score_threshold is {self.score_threshold}, expected 0 to 1')


class Model:
    """An onnxruntime session with its input's size, its output's layout and its class names.

    The layout is recognised from the output for one grey image, which also warms the session up. From the metadata come
    `box_padding` (2,), by how many pixels of the input the model's boxes are wider and higher than the objects, and `near`,
    the longer side in pixels of a second, smaller input for large objects (0 for none), and `score_threshold`.
    Raises ModelError for a file that is missing, damaged or no YOLO detector, and for a provider that is not installed.

    Parameters:
        path: ONNX file.
        settings: options.
    """

    def __init__(self, path: str | Path, settings: DetectorSettings = DetectorSettings()) -> None:
        self.path = Path(path).expanduser()
        self.session = open_session(self.path, settings.providers, settings.threads)
        self.metadata = dict(self.session.get_modelmeta().custom_metadata_map)
        self._input = self._check_input()
        self.dtype = FLOATS[self._input.type]
        size = self._input.shape[2:]
        self.dynamic_size = not all(isinstance(side, int) for side in size)
        self.longest = self._longest(settings.input_size, size)
        self.size = (self.longest, self.longest) if self.dynamic_size else tuple(size)
        self.box_padding = np.array(self._stated('padding', '[0, 0]', _is_padding, '[width, height] to 100 pixels'), np.float32)
        near = self._stated('near_imgsz', '0', lambda given: isinstance(given, int) and given >= 0 and given % 32 == 0,
                            'a multiple of 32')
        # Only where the first input is so much larger that the second costs little.
        self.near = near if self.dynamic_size and self.longest >= 3 * near else 0
        self.score_threshold = float(self._stated(
            'score_threshold', '0.25', lambda given: isinstance(given, (int, float)) and 0.0 <= given <= 1.0, '0 to 1'))
        names = settings.class_names or self._names()
        output, classes = self._look(np.full((1, 3, *self.size), LETTERBOX_GREY / 255.0, self.dtype))
        try:
            self.layout = recognise(output, self.size, len(names) or classes)
        except LayoutError as error:
            raise ModelError(f'{self.path}: {error}') from error
        self.class_names = self._class_names(names, self.layout.classes)

    @property
    def columns(self) -> str:
        """What the columns of a table of boxes are taken for; empty for layouts of cells."""
        return self.layout.columns

    @property
    def provider(self) -> str:
        """The execution provider that is used first."""
        return str(self.session.get_providers()[0])

    def run(self, tensor: NDArray) -> NDArray[np.float32]:
        """Output (1, a, b) for an image (1, 3, height, width)."""
        return self._look(tensor)[0]

    def _look(self, tensor: NDArray) -> tuple[NDArray[np.float32], int]:
        """See `joined`."""
        given = {self._input.name: tensor}
        if self._sizes:
            given[self._sizes] = np.array([tensor.shape[:1:-1]])
        try:
            return joined(self.session.run(None, given))
        except Exception as error:  # onnxruntime's exceptions have no common base
            raise ModelError(f'{self.path} does not run on images of shape {tensor.shape}: {one_line(error)}') from error

    def boxes(self, image: NDArray[np.uint8], shown: tuple[float, float], threshold: float) -> Decoded:
        """Boxes in pixels of the input, and probabilities of the classes. Raises ModelError.

        Parameters:
            image (height, width, 3): BGR image of the size of the input.
            shown: height and width of what it shows, without the padding.
            threshold (0-1): least probability of a box.
        """
        tensor = to_tensor(image, self.layout.rgb, self.dtype)
        output, size = self.run(tensor)[0], (image.shape[0], image.shape[1])
        try:
            self.layout.settle(output, size, shown, lambda: self.run(np.ascontiguousarray(tensor[..., ::-1]))[0])
            boxes, probabilities = self.layout.decode(output, size, threshold)
        except LayoutError as error:
            raise ModelError(f'{self.path}: {error}') from error
        return boxes, np.minimum(probabilities, 1.0)

    def _check_input(self) -> onnxruntime.NodeArg:
        inputs = self.session.get_inputs()
        if self.metadata.get('task', 'detect') != 'detect':
            raise ModelError(f'{self.path} is a model for the task {self.metadata["task"]!r}, expected detect')
        # RT-DETR and its successors are told to which width and height their boxes shall be scaled: here to the input's.
        self._sizes = next((one.name for one in inputs[1:] if (one.type, one.shape[1:]) == ('tensor(int64)', [2])), '')
        if len(inputs) != (2 if self._sizes else 1):
            raise ModelError(f'{self.path} has {len(inputs)} inputs, expected one image, as YOLO detectors have')
        one = inputs[0]
        if one.type not in FLOATS:
            raise ModelError(f'{self.path} has an input of {one.type}, expected float or float16 images')
        if len(one.shape) != 4 or (isinstance(one.shape[1], int) and one.shape[1] != 3):
            raise ModelError(f'{self.path} has an input of shape {one.shape}, expected (batch, 3, height, width)')
        if isinstance(one.shape[0], int) and one.shape[0] != 1:
            raise ModelError(f'{self.path} has batches of {one.shape[0]}, expected 1 or a dynamic batch')
        if any(isinstance(side, int) and not 32 <= side <= LONGEST for side in one.shape[2:]):
            raise ModelError(f'{self.path} has an input of shape {one.shape}, expected 32 to {LONGEST} pixels')
        return one

    def _longest(self, wanted: int, size: list[Any]) -> int:
        if not self.dynamic_size:
            if wanted not in (0, max(size)):
                raise ModelError(f'input_size is {wanted}, but {self.path} has the fixed input {size[0]}x{size[1]}')
            return int(max(size))
        if wanted == 0:
            stated: Any = parsed(self.metadata.get('imgsz', '640'))
            sides = stated if isinstance(stated, (list, tuple)) else [stated]
            wanted = max([side for side in sides if isinstance(side, int)], default=0)
        if not 32 <= wanted <= LONGEST or wanted % 32:
            raise ModelError(f'{self.path}: input_size is {wanted}, expected a multiple of 32, at most {LONGEST}')
        return wanted

    def _stated(self, key: str, default: str, fits: Callable[[Any], bool], expected: str) -> Any:
        """An entry of the metadata. Raises ModelError for one that does not fit, with what is expected."""
        text = self.metadata.get(key, default)
        if not fits(given := parsed(text)):
            raise ModelError(f'{self.path} has {key} {shown(text)} in its metadata, expected {expected}')
        return given

    def _names(self) -> tuple[str, ...]:
        """Class names from the metadata's `names`, a dictionary or a list in Python's or JSON's spelling; empty without."""
        names = parsed(self.metadata.get('names', '[]'))
        try:
            names = [names[key] for key in sorted(names, key=int)] if isinstance(names, dict) else names
        except (ValueError, TypeError, OverflowError) as error:
            raise ModelError(f'{self.path}: the keys of names in its metadata are no numbers: {one_line(error)}') from error
        return tuple(str(name) for name in names) if isinstance(names, (list, tuple)) else ()

    def _class_names(self, names: tuple[str, ...], count: int) -> tuple[str, ...]:
        if names and count and len(names) != count:
            raise ModelError(f'{self.path} has {count} classes, but {len(names)} class names are given: {shown(names)}')
        if not names and count == len(COCO):
            return COCO  # exports without names and with 80 classes are COCO models
        # The output of an end-to-end export does not show the number of classes.
        return names or tuple(f'class_{i}' for i in range(count or 1000))


@cache
def limit_memory() -> None:
    """Limit the memory that all sessions of this process take for images and results to MOST_MEMORY.

    A model of some bytes may make any amount of output. Without the limit the kernel may end another process instead.
    """
    memory = onnxruntime.OrtMemoryInfo('Cpu', onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR, 0,
                                       onnxruntime.OrtMemType.DEFAULT)
    onnxruntime.create_and_register_allocator(memory, onnxruntime.OrtArenaCfg({'max_mem': MOST_MEMORY}))


def open_session(path: Path, providers: Sequence[str], threads: int) -> onnxruntime.InferenceSession:
    """Open an onnxruntime session; raises ModelError for an unusable file, and where no provider is installed.

    Parameters:
        path: ONNX file.
        providers: execution providers in order of preference; those that are not installed are left out.
        threads: number of threads for one image; 0 uses the default of onnxruntime.
    """
    every, installed = onnxruntime.get_all_providers(), onnxruntime.get_available_providers()
    for provider in providers:
        if provider not in every:
            raise ModelError(f'providers has {provider}, which is none of onnxruntime, the nearest is '
                             f'{nearest(provider, every)}')
    usable = [provider for provider in providers if provider in installed]
    if not usable:
        raise ModelError(f'providers are {list(providers)}, but onnxruntime has {installed} here; install the onnxruntime '
                         'package of the accelerator (onnxruntime-gpu, onnxruntime-openvino) or choose among these')
    try:
        check_file(path, MOST_BYTES, 'model')
    except OSError as error:
        raise ModelError(str(error)) from error
    if path.stat().st_size == 0:
        raise ModelError(f'model {path} is empty (0 bytes)')
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 4   # errors are raised; this would print them as well
    limit_memory()
    options.add_session_config_entry('session.use_env_allocators', '1')
    # A plan of memory for each input size would be kept for ever, 48 MiB for a whole image that is searched after regions.
    options.enable_mem_pattern = False
    # Spinning of idle threads would take processor time from the other nodes.
    options.add_session_config_entry('session.intra_op.allow_spinning', '0')
    try:
        # Constants that are computed now do not count towards MOST_MEMORY, those that are computed with an image do.
        return onnxruntime.InferenceSession(str(path), options, providers=usable, disabled_optimizers=['ConstantFolding'])
    except Exception as error:  # onnxruntime's exceptions have no common base
        raise ModelError(f'{path} is no ONNX model that onnxruntime can open: {one_line(error)}') from error


def parsed(text: str) -> object:
    """A literal of Python, which lists and mappings of texts and numbers in JSON are, too; None when it is none."""
    with suppress(ValueError, TypeError, SyntaxError, RecursionError, MemoryError):    # nested too deep, or of what has no hash
        return ast.literal_eval(text)
    return None


def _is_padding(given: Any) -> bool:
    return isinstance(given, (list, tuple)) and len(given) == 2 and all(
        isinstance(one, (int, float)) and 0 <= one <= 100 for one in given)
