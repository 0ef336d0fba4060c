"""Settings of every test run."""

import contextlib
import os
import signal
import sys

import psutil
import pytest
import repeated_tests
from ros_domains import free_domain

# Under nohup SIGHUP is ignored, and by all that tests start, too.
signal.signal(signal.SIGHUP, signal.SIG_DFL)
# Faults of the program end a node under test, instead of being counted and logged: see av_common/refused_inputs.py.
os.environ['AV_STRICT'] = '1'
# A field of a wrong type ends a process when it is published, without a word of Python: it raises here.
os.environ['ROS_PYTHON_CHECK_FIELDS'] = '1'
# There is a worker for each core: threads of linear algebra would wait for each other. It is read where numpy is imported.
os.environ.setdefault('OMP_NUM_THREADS', '1')


@pytest.hookimpl(tryfirst=True)    # xdist reads the groups in its own hook
def pytest_collection_modifyitems(items):
    """With `-n`, tests of whole rigs begin, one after the other; beside them run those that start nodes, then all others.

    Tests of one file share a process.
    """
    def order(item):
        starts = item.get_closest_marker('system') is not None
        return not starts, starts and item.path.parent != item.config.rootpath / 'test'

    items.sort(key=order)
    for item in items:
        item.add_marker(pytest.mark.xdist_group('rig' if order(item) == (False, False) else item.path.name))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item, nextitem):
    """Tests marked `system` may be repeated."""
    return repeated_tests.run(item, nextitem) if item.get_closest_marker('system') else None


@pytest.fixture(autouse=True, scope='module')
def own_ros_domain():
    """No module hears the nodes of another run or module, nor shares the machine with what another left running."""
    os.environ['ROS_DOMAIN_ID'] = str(free_domain())
    before = set(psutil.Process().children(recursive=True))
    yield
    if 'rclpy' in sys.modules:
        sys.modules['rclpy'].try_shutdown()    # a fixture that fails after `rclpy.init` does not fail those that follow
    for process in set(psutil.Process().children(recursive=True)) - before:
        with contextlib.suppress(psutil.NoSuchProcess):
            if not any('resource_tracker' in word for word in process.cmdline()):    # of multiprocessing
                process.kill()


def pytest_sessionfinish(session):
    """A run in which every test was skipped has tested nothing."""
    reporter = session.config.pluginmanager.get_plugin('terminalreporter')
    if session.exitstatus == pytest.ExitCode.OK and reporter and not reporter.stats.get('passed'):
        session.exitstatus = pytest.ExitCode.NO_TESTS_COLLECTED
