from canopen_control.cli.main import main


def test_it_says_what_it_did_and_how_to_go_on(mock_robot, capsys):
    assert main(["stop"]) == 0
    assert "axis enable all" in capsys.readouterr().out


def test_without_a_robot_it_is_a_usage_error(capsys):
    assert main(["stop"]) == 2
    assert "no robot is running" in capsys.readouterr().err
