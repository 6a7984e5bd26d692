from canopen_control.cli.main import main


def test_it_says_what_it_did_and_how_to_go_on(mock_robot, capsys):
    assert main(["stop"]) == 0
    assert "axis enable all" in capsys.readouterr().out


def test_without_a_robot_it_is_a_usage_error(capsys):
    assert main(["stop"]) == 2
    assert "no robot is running" in capsys.readouterr().err


def test_a_latched_stop_lasts_until_the_release(mock_robot, capsys):
    assert main(["stop", "--latch"]) == 0
    assert "canopen-control stop --release" in capsys.readouterr().out
    assert main(["command", "robby_forward_controller", "1", "1", "--once"]) == 1
    assert "STOP is latched (by canopen-control stop)" in capsys.readouterr().err
    assert main(["stop", "--release"]) == 0
    assert "axis enable all" in capsys.readouterr().out
    assert main(["command", "robby_forward_controller", "1", "1", "--once"]) == 0
