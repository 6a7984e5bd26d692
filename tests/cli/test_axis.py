import pytest

from canopen_control.cli.main import main


def test_all_axes_of_a_robot_without_drives_are_done_at_once(mock_robot, capsys):
    assert main(["axis", "enable", "all"]) == 0
    assert capsys.readouterr().out == "enable all: done\n"


def test_an_unknown_node_is_one_sentence(mock_robot, capsys):
    assert main(["axis", "enable", "nobody"]) == 1
    assert "nobody" in capsys.readouterr().err


def test_an_unknown_action_is_a_usage_error():
    with pytest.raises(SystemExit) as caught:
        main(["axis", "explode", "all"])
    assert caught.value.code == 2
