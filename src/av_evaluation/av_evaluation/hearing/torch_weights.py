"""Reads weights that PyTorch has saved, without PyTorch and without running any code of the file."""

from __future__ import annotations

import pickle
from collections import OrderedDict
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

import numpy as np
from numpy.typing import NDArray

DTYPES = {'FloatStorage': np.float32, 'LongStorage': np.int64}


def read_weights(path: Path) -> dict[str, NDArray]:
    """Arrays by name of the `model` of a checkpoint, without the prefix `module.` of parallel training.

    Raises OSError, or ValueError for a file that is no such checkpoint.
    """
    try:
        with ZipFile(path) as archive:
            content = next(name for name in archive.namelist() if name.endswith('/data.pkl'))
            with archive.open(content) as file:
                model = _Reader(file, archive, content.removesuffix('data.pkl')).load()['model']
            return {str(name).removeprefix('module.'): np.asarray(array) for name, array in model.items()}
    except (BadZipFile, StopIteration, KeyError, TypeError, AttributeError, ValueError, pickle.UnpicklingError) as error:
        raise ValueError(f'{path} is no checkpoint of PyTorch with a model: {error}') from error


class _Reader(pickle.Unpickler):
    """Knows tensors in contiguous storages and ordered dictionaries, and refuses everything else."""

    def __init__(self, file: Any, archive: ZipFile, folder: str) -> None:
        super().__init__(file)
        self._archive, self._folder = archive, folder

    def find_class(self, module: str, name: str) -> Any:
        if module == 'torch' and name in DTYPES:
            return DTYPES[name]
        known = {('collections', 'OrderedDict'): OrderedDict, ('torch._utils', '_rebuild_tensor_v2'): _tensor}
        if (module, name) not in known:
            raise pickle.UnpicklingError(f'{module}.{name} is not expected')
        return known[module, name]

    def persistent_load(self, pid: Any) -> NDArray:
        _, dtype, key, _, _ = pid
        return np.frombuffer(self._archive.read(f'{self._folder}data/{key}'), dtype)


def _tensor(storage: NDArray, offset: int, size: tuple[int, ...], *_: Any) -> NDArray:
    return storage[offset:offset + int(np.prod(size, dtype=int))].reshape(size)
