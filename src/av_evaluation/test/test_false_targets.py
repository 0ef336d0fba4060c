"""The program that counts false targets: in wind there are none, and a drone is found."""

from __future__ import annotations

import pytest

from av_evaluation.cli.false_targets import main


def test_wind_is_no_drone_and_a_drone_in_it_is_found(capsys):
    assert main(['--places', 'wind', '--runs', '1', '--seconds', '6', '--seed', '3']) == 0
    nothing, drone = (line.split()[2:] for line in capsys.readouterr().out.splitlines()[-2:])
    assert nothing == ['0', '/', '0%'] * 5
    shares = [int(share.rstrip('%')) for share in drone]
    assert shares[0] > 50 and shares == sorted(shares, reverse=True)


def test_a_place_that_is_not_known_is_refused(capsys):
    with pytest.raises(SystemExit):
        main(['--places', 'moon'])
    assert 'wind' in capsys.readouterr().err
