import pytest

from canopen_control.cli.main import main
from canopen_control.cli.verbs import GROUPS, MAX_USED, VERBS


def printed(capsys, *words):
    assert main(["help", *words]) == 0
    return capsys.readouterr().out


def test_all_lists_every_verb_in_one_line_each_under_its_group(capsys):
    lines = printed(capsys, "--all").splitlines()
    assert max(map(len, lines)) <= 80
    assert [line[:-1] for line in lines if line.endswith(":") and not line.startswith(" ")] == list(GROUPS)
    assert [line.split()[0] for line in lines if line.startswith("  ")] == list(VERBS)


def test_without_a_verb_it_is_the_help_of_the_program(capsys):
    text = printed(capsys)
    with pytest.raises(SystemExit):
        main(["--help"])
    assert capsys.readouterr().out == text
    assert all(verb in VERBS for verb in MAX_USED)


@pytest.mark.parametrize("words", [["run"], ["bus", "status"]])
def test_of_a_verb_or_an_action_it_is_what_its_own_option_prints(capsys, words):
    with pytest.raises(SystemExit) as caught:
        main(["help", *words])
    assert caught.value.code == 0
    output = capsys.readouterr().out
    with pytest.raises(SystemExit):
        main([*words, "--help"])
    assert capsys.readouterr().out == output


def test_of_an_unknown_verb_it_is_a_usage_error(capsys):
    assert main(["help", "statsu"]) == 2
    assert "did you mean status?" in capsys.readouterr().err
