"""The verdict on a long run: growth after settling, threads and descriptors, processes that ended or came late."""

import pytest

from av_evaluation.cli.soak import ProcessHistory, format_histories, lasting, sound_faults
from av_evaluation.processes import ProcessSample

LIMITS = 300.0, 5.0     # s, MiB
END = 3600.0


def history(resident, name='node', threads=lambda time: 9, begin=0.0, end=END):
    made = ProcessHistory(name)
    time = begin
    while time <= end:
        made.add(time, ProcessSample(resident(time), threads(time), 30))
        time += 5.0
    return made


def steady(time):
    return 100.0 + min(time, 250.0) / 2.0   # grows at first, as every process does


@pytest.mark.parametrize(('made', 'fault'), [
    (history(steady), []),
    (history(lambda time: steady(time) + 4.9 * time / END), []),
    (history(lambda time: steady(time) + 6.0 * time / END), ['grew by 5.4 MiB']),
    (history(lambda time: steady(time) + 50.0 * (1000.0 < time < 1010.0)), []),     # a peak that is given back
    (history(lambda time: steady(time) - 0.01 * time), []),
    (history(steady, threads=lambda time: 9 + (time > 3000.0)), ['9 to 10 threads']),
    (history(steady, threads=lambda time: 9 + (time > 200.0)), []),
    (history(steady, threads=lambda time: 9 + (time % 600.0 == 0.0)), []),      # for a moment, now and then
    (history(steady, threads=lambda time: 9 + int(time // 600.0)), ['9 to 14 threads']),
    (history(steady, end=3000.0), ['ended after 3000 s']),
    (history(steady, begin=600.0), ['started after 600 s']),
])
def test_what_does_not_stay_as_it_was_is_named(made, fault):
    assert made.faults(*LIMITS, END) == fault
    assert (', '.join(fault) or 'holds') in format_histories([made], *LIMITS, END)


def test_programs_of_a_moment_are_left_out():
    short, long = history(steady, 'shell', end=5.0), history(steady)
    assert lasting([short, long]) == [long]


def test_a_rig_that_recorded_nothing_has_a_verdict(tmp_path):
    assert 'gone.mcap: no such bag' in sound_faults(tmp_path / 'gone.mcap')[0]
