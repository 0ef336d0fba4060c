"""Prints the JSON Schema of scenario files: `ros2 run av_simulator scenario_schema > config/scenario.schema.json`."""

from __future__ import annotations

import json

from av_simulator.config_schema import schema
from av_simulator.scenario import Scenario


def main() -> None:
    """Print the schema."""
    print(json.dumps(schema(Scenario), indent=1))
