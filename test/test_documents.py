"""Pages do not rot: their commands can be typed, sentences are short, launches have the arguments of the tutorials."""

from __future__ import annotations

import re
import shlex

import pytest
from tutorials import PROJECT, run, tool

TUTORIALS = sorted(PROJECT.glob('docs/tutorials/*.md'))


@pytest.mark.parametrize('command', [
    'ros2 run av_audio lokalize x.wav', 'ros2 launch av_fusion rig.launch.py scenaro:=circle', 'make frob',
    'ros2 launch av_fusion rigg.launch.py', 'ros2 launch av_fusion rig.launch.py scenario:=nowhere',
    'ros2 run av_audio doa_node --ros-args -p metod:=phat',
    'ros2 run av_evaluation evaluate circle --out results --sedes 3', 'ros2 run av_audio localize "x.wav',
    'ros2 run av_evaluation evaluate circle', 'ros2 run av_view doctor --clap nowhere',
    'ros2 run av_evaluation evaluate circle --out results --from air', 'ros2 run av_bags repair_bag flight.mcap'])
def test_a_command_that_cannot_be_typed_is_found(command):
    assert list(tool('commands').faults_of(command))


def test_the_commands_of_all_pages_can_be_typed():
    """With the parsers of the programs, which lint has only after a build."""
    assert not tool('commands').main()


def test_a_parameter_that_no_node_has_is_found():
    faults_of_yaml = tool('commands').faults_of_yaml
    block = '/**/detector_node:\n  ros__parameters:\n    {}: 1\n'
    assert list(faults_of_yaml(block.format('modell'))) and not list(faults_of_yaml(block.format('regions')))


def test_long_sentences_are_found_and_others_are_not():
    sentences = tool('sentences')
    long, short = ' '.join(['word'] * 41), ' '.join(['word'] * 39)
    text = (f'# Title\n\n{short}. {short}.\n\n- {short}\n- {short}\n\n```bash\n{long}\n```\n\n| {long} |\n|---|\n\n'
            f'Then {long}.\n')
    found = [line for line, sentence in sentences.sentences(text) if sentences.words(sentence) > sentences.MOST]
    assert found == [15]


def test_launch_files_show_the_arguments_of_the_tutorials():
    """What is launched is declared by the launch files themselves, not only by the text that lint reads."""
    lines = [shlex.split(command, comments=True) for page in TUTORIALS for command in tool('commands').commands(page)]
    wanted = {(words[3], one.partition(':=')[0]) for words in lines if words[:2] == ['ros2', 'launch'] and len(words) > 3
              for one in words[4:] if ':=' in one}
    for file in {file for file, _ in wanted}:
        shown = run(f'ros2 launch av_fusion {file} -s', PROJECT)
        assert {name for other, name in wanted if other == file} <= set(re.findall(r"'(\w+)'", shown))
