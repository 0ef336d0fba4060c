"""Launches with mistakes in their arguments and files: the mistake by its name, an exit code, and nothing started.

One mistake of each launch file goes through `ros2 launch`; the others are found in the same function in this process.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import soundfile
from bag_messages import flight
from launch import LaunchContext
from rig_process import RigProcess

from av_bringup.launching import (
    DDS_VARIABLE,
    MOST_PARTICIPANTS,
    launched_nodes,
    participants,
)
from av_common.launched import RUN_FOLDER

FIELD_CASES = Path(__file__).resolve().parents[2] / 'shared/data/field_cases/parameters'
PARAMETERS = '/**/pointing_node: {ros__parameters: {yaw_raet_deg: 5.0}}\n'


@pytest.fixture
def refused(launch_file, network_file, monkeypatch):
    """What a launch with some arguments is refused with, before a process is started."""
    def refused(*arguments, network=False):
        launched = network_file if network else launch_file
        monkeypatch.setattr(sys, 'argv', ['launch', launched.__file__, *arguments])
        context = LaunchContext(argv=list(arguments))
        context.extend_locals({'current_launch_file_path': launched.__file__})
        context.launch_configurations.update(argument.split(':=') for argument in arguments)
        with pytest.raises(Exception) as refusal:
            for entity in launched.generate_launch_description().entities:
                entity.execute(context)
        return str(refusal.value)
    return refused


@pytest.mark.parametrize(('network', 'arguments', 'text', 'words'), [
    (False, ['namespace:=left'], 'pointing_node: {ros__parameters: {move_body: false}}',
     'no node is /pointing_node, the nearest is /left/pointing_node'),
    (False, [], '/**/fusion_node: {ros__parameters: {tau: 3.0}}',
     "/**/fusion_node: Value 3.0 in parameter 'tau' must be within bounds [0.0, 1.0]"),
    (False, [], '/**/fusion_node: {ros__parameters: {tau: high}}', "/**/fusion_node: tau is 'high', expected double"),
    (False, [], '/**: {ros__parameters: {tau: .nan}}', '/**: tau is nan, expected a finite number'),
    (False, [], PARAMETERS, '/**/pointing_node has no parameter yaw_raet_deg, the nearest is yaw_rate_deg'),
    (True, ['rigs:=2'], '/rig3/fusion_node: {ros__parameters: {tau: 0.6}}',
     'no node is /rig3/fusion_node, the nearest is /rig'),
    (True, ['rigs:=2'], '/network_nod: {ros__parameters: {rate: 5.0}}', 'the nearest is /network_node')])
def test_a_mistake_in_a_parameter_file_stops_the_launch(tmp_path, refused, network, arguments, text, words):
    file = tmp_path / 'params.yaml'
    file.write_text(text)
    assert words in refused(*arguments, f'params:={file}', network=network)


@pytest.mark.parametrize(('name', 'words'), [('no_slash', 'no node is /fusion_node, the nearest is /left/fusion_node'),
                                             ('misspelt_node', 'no node is /**/fusion_nod, the nearest is /**/fusion_node')])
def test_the_parameter_files_of_the_field(refused, name, words):
    if not FIELD_CASES.exists():
        pytest.skip('needs ../shared/data')
    assert words in refused('namespace:=left', f'params:={FIELD_CASES}/{name}.yaml')


def test_sections_for_some_rigs_of_a_network_are_accepted(network_file, tmp_path):
    file = tmp_path / 'params.yaml'
    file.write_text('/rig2/fusion_node: {ros__parameters: {tau: 0.6}}\n/network_node: {ros__parameters: {rate: 5.0}}\n')
    values = {name: default for name, (default, _, _) in network_file.ARGUMENTS.items()}
    entities = network_file.start({**values, 'params': str(file), 'rigs': '2', RUN_FOLDER: str(tmp_path)})
    names = [node.full_name for node in launched_nodes(entities)]
    assert {'/rig1/fusion_node', '/rig2/fusion_node', '/rig2/bridge_node', '/network_node'} <= set(names)
    assert len(names) == len(set(names))


def test_a_network_in_a_namespace_hears_its_rigs(network_file, tmp_path, monkeypatch):
    """It listened below its namespace, where they are not."""
    given, make = {}, network_file.rig_node
    monkeypatch.setattr(network_file, 'rig_node', lambda arguments, package, name, values: (
        given.update(values), make(arguments, package, name, values))[1])
    values = {name: default for name, (default, _, _) in network_file.ARGUMENTS.items()}
    entities = network_file.start({**values, 'namespace': 'fleet', 'rigs': '2', RUN_FOLDER: str(tmp_path)})
    names = [node.full_name for node in launched_nodes(entities)]
    assert '/fleet/network_node' in names and all(f'{rig}/fusion_node' in names for rig in given['rigs'])


def test_eight_rigs_are_more_participants_than_dds_has_as_it_comes(network_file, tmp_path, monkeypatch):
    """And each gets a profile that has room for them, where the user has none."""
    values = {name: default for name, (default, _, _) in network_file.ARGUMENTS.items()}
    entities = network_file.start({**values, 'rigs': '8', RUN_FOLDER: str(tmp_path)})
    assert len(launched_nodes(entities)) > MOST_PARTICIPANTS
    monkeypatch.delenv(DDS_VARIABLE, raising=False)
    first, note = participants(entities)
    assert Path(first.value[0].text.removeprefix('file://')).is_file()
    assert DDS_VARIABLE in note.msg[0].text
    monkeypatch.setenv(DDS_VARIABLE, '')
    assert participants(entities) == []


@pytest.mark.system
@pytest.mark.parametrize(('launch_file', 'scenario', 'nearest'), [('rig.launch.py', 'occluded_rom', 'occluded_room'),
                                                                  ('network.launch.py', 'circel', 'circle')])
def test_a_misspelt_scenario_ends_the_launch_and_is_named_with_the_nearest(launch_file, scenario, nearest):
    rig = RigProcess(f'scenario:={scenario}', launch_file=launch_file)
    assert rig.finish(60.0) != 0, rig.output
    assert f'{scenario}: no such file, the nearest is {nearest}' in rig.output
    assert 'process started' not in rig.output, rig.output
    assert not rig.leftovers()


@pytest.mark.parametrize(('network', 'argument', 'words'), [
    (False, 'namspace:=left', 'namspace:= is no argument of rig.launch.py, the nearest is namespace:='),
    (True, 'rig:=3', 'rig:= is no argument of network.launch.py, the nearest is rigs:='),
    (True, 'rigs:=2.5', "rigs is '2.5', expected a whole number from 1 to 8"),
    (False, f'audio:={__file__}', 'needs source:=file, and source is sim'),
    (False, 'namespace:=rig-1', "namespace is 'rig-1', expected a name of ROS"),
    (False, 'namespace:=1rig', "namespace is '1rig', expected a name of ROS"),
    (True, 'namespace:=a b', "namespace is 'a b', expected a name of ROS"),
    (False, 'out:=~nobody_of_this_name/x', "out is '~nobody_of_this_name/x': Could not determine home directory")])
def test_an_argument_without_effect_stops_the_launch(refused, network, argument, words):
    assert words in refused(argument, network=network)


def test_recordings_and_arrays_that_cannot_be_used_are_refused_before_anything_starts(refused, tmp_path):
    """They were errors of nodes that tried again and again, in a launch that ended with 0."""
    soundfile.write(tmp_path / 'mono.wav', np.zeros(48_000), 48_000)
    (tmp_path / 'text.wav').write_text('no sound')
    (tmp_path / 'text.mp4').write_text('no video')
    (tmp_path / 'empty').mkdir()
    (tmp_path / 'one.yaml').write_text('microphones: [[0.0, 0.0, 0.0]]')
    for arguments, words in {
            'audio:={}/mono.wav': 'mono.wav gives 1 channel(s), but the array two_microphones has 2 microphones',
            'audio:={}/text.wav': 'text.wav cannot be read', 'audio:={}/empty': 'empty is a folder, expected a file',
            'video:={}/text.mp4': 'text.mp4 (8 bytes) cannot be opened as a video', 'video:={}/empty': 'empty holds no images',
            'array:={}/one.yaml': 'one.yaml: microphones: expected at least two positions'}.items():
        assert words in refused('source:=file', *arguments.format(tmp_path).split()), arguments


@pytest.mark.parametrize(('arguments', 'words'), [
    ('bind_address:=0.0.0.0', 'bind_address is 0.0.0.0, which other machines reach, but allowed_senders is 127.0.0.0/8'),
    ('allowed_senders:=192.168.1.20', 'allowed_senders is 192.168.1.20, but bind_address 127.0.0.1 receives from this'),
    ('allowed_senders:=simulator bind_address:=0.0.0.0', "allowed_senders has 'simulator', expected an IPv4 address"),
    ('allowed_senders:=192.168.1.20:99999 bind_address:=0.0.0.0', "'99999' is no port"),
    ('bind_address:=localhost', "bind_address is 'localhost', expected an IPv4 address")])
def test_addresses_of_a_simulator_that_cannot_be_are_refused(refused, arguments, words):
    """The node tried again and again, without a word on the screen."""
    assert words in refused('source:=udp', 'oracle:=true', *arguments.split())


@pytest.mark.parametrize('value', ['192.168.1.20', '[5]', '5'])
def test_addresses_in_a_parameter_file_that_are_no_list_of_texts_are_refused(refused, tmp_path, value):
    (tmp_path / 'params.yaml').write_text(f'/**/bridge_node: {{ros__parameters: {{allowed_senders: {value}}}}}')
    told = refused('source:=udp', 'oracle:=true', 'bind_address:=0.0.0.0', f"params:={tmp_path / 'params.yaml'}")
    assert 'bridge_node: allowed_senders is ' in told and 'expected string_array' in told


def test_addresses_in_a_parameter_file_count(launch_file, tmp_path):
    file = tmp_path / 'params.yaml'
    file.write_text('/**/bridge_node: {ros__parameters: {allowed_senders: [192.168.1.20]}}')
    values = {name: default for name, (default, _, _) in launch_file.ARGUMENTS.items()}
    assert launch_file.start({**values, 'source': 'udp', 'oracle': 'true', 'bind_address': '0.0.0.0', 'params': str(file),
                              RUN_FOLDER: str(tmp_path)})


@pytest.mark.parametrize(('given', 'words'), [
    ({'start': '99'}, 'start is 99 s, and the bag has 1.0 s'), ({'model': 'nosuch'}, 'expected an ONNX file or one of shipped'),
    ({'model': 'nosuch.onnx'}, 'model nosuch.onnx does not exist'),
    ({'rate': '-1'}, 'player_node: Value -1.0 in parameter')])
def test_a_replay_of_nothing_is_refused(replay_file, tmp_path, given, words):
    values = {name: default or '' for name, (default, _, _) in replay_file.ARGUMENTS.items()}
    bag = flight(tmp_path / 'flight.mcap', duration=1.0)
    with pytest.raises((ValueError, OSError), match=words):
        replay_file.start({**values, 'bag': str(bag), RUN_FOLDER: str(tmp_path), **given})


def test_a_recording_that_exists_is_not_flown_without(refused, tmp_path):
    """The rig flew, and its recorder was given up."""
    (tmp_path / 'first.mcap').touch()
    assert 'first.mcap exists already' in refused('source:=hardware', f'record:={tmp_path}/first.mcap')


def test_a_scenario_with_a_misspelt_key_is_named(refused, tmp_path):
    file = tmp_path / 'mine.yaml'
    text = (Path(__file__).resolve().parents[1] / 'config/scenarios/circle.yaml').read_text()
    file.write_text(text.replace('snr:', 'snrr:'))
    assert 'snrr' in refused(f'scenario:={file}')


@pytest.mark.parametrize(('argument', 'complaint'), [
    ('drone_recording:=/no/such.wav', 'drone_recording:=/no/such.wav: no such file'),
    ('cot:=http://x', "report_node: cot.url is 'http://x', expected udp://"),
    ('duration:=soon', "duration is 'soon'"),
    ('duration:=-3', "duration is '-3', expected seconds"),
    ('port_offset:=2.5', "port_offset is '2.5', expected a whole number"),
    ('port_offset:=99999', "port_offset is '99999', expected a whole number from"),
    ('seed:=x', "seed is 'x', expected a number"), ('model:=nosuch', "model 'nosuch', expected an ONNX file or one of shipped"),
    ('model:=/no/such.onnx', 'model /no/such.onnx does not exist'),
    ('image_rate:=-3', "image_rate is '-3', expected images a second, 0 or more"), ('at:=1 2', "at is '1 2', expected x y z"),
    ('begin:=nan', "begin is 'nan', expected a Unix time"),
    ('out:=/proc/results', 'out:=/proc/results cannot be made'),
    ('track_log:=/proc/tracks', 'track_log:=/proc/tracks cannot be made'),
    ('view_control:=true', 'view_control:=true needs view:=true'),
    ('source:=magic', 'source')])
def test_a_wrong_argument_is_named(refused, argument, complaint):
    assert complaint in refused(argument)
