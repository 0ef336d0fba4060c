"""What all contracts share: each states its figures with their bounds, and keeps them for comparison."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from figures import Bound


@pytest.fixture
def contract(request):
    """A function of bounds: records their figures in the file that CONTRACT_FIGURES names; fails where one does not hold."""
    def check(*bounds: Bound) -> None:
        file = os.environ.get('CONTRACT_FIGURES')
        if file:
            known = json.loads(Path(file).read_text()) if Path(file).is_file() else {}
            name = request.node.nodeid.partition('test_contract_')[2].replace('.py::test', ':')
            known |= {f'{name}, {bound.name}': bound.row() for bound in bounds}
            Path(file).write_text(json.dumps(known, indent=1))
        broken = [str(bound) for bound in bounds if not bound.holds]
        assert not broken, '; '.join(broken)
    return check
