"""What each package exports exists, and says what it is."""

from __future__ import annotations

import inspect
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

PACKAGES = sorted(file.parent.name for file in (Path(__file__).parents[1] / 'src').glob('*/setup.py'))


@pytest.mark.parametrize('package', PACKAGES)
def test_every_public_name_exists_and_is_documented(package):
    module = import_module(package)
    assert module.__all__
    assert not [name for name in module.__all__ if (Path(module.__file__).parent / f'{name}.py').exists()], 'names of modules'
    for name in module.__all__:
        found = getattr(module, name)
        if inspect.isclass(found) or inspect.isfunction(found):
            assert (inspect.getdoc(found) or '').strip(), f'{package}.{name} says nothing'


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="'av_audio' has no attribute 'Lokalizer'"):
        _ = import_module('av_audio').Lokalizer


def test_a_package_is_imported_without_what_it_does_not_need():
    code = "import sys, av_audio, av_fusion, av_vision; assert 'scipy' not in sys.modules and 'cv2' not in sys.modules"
    assert subprocess.run([sys.executable, '-c', code], check=False).returncode == 0
