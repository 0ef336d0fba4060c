"""Physics simulator: sound, images and truth of drones, sent as RFlySim sends them."""

from av_common.exports import exports

__all__, __getattr__ = exports(__name__, {
    'config_files': 'find_config shipped',
    'run': 'open_world steps',
    'scenario': 'Bystander RigMotion Scenario Target Weather load_scenario',
    'simulator': 'Simulator WireOptions',
    'trajectories': 'Circle FigureEight Line RandomFlight Static Steps Waypoints',
    'world': 'World',
})
