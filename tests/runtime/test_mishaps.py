from canopen_control.master.events import Level
from canopen_control.runtime.mishaps import Mishaps


def broken(number):
    raise ZeroDivisionError(f"divided {number}")


def caught(number):
    try:
        broken(number)
    except ZeroDivisionError as error:
        return error


def test_a_fault_of_the_program_is_an_event_with_its_place_and_told_once(capsys):
    told = []
    mishaps = Mishaps(lambda: 7, told.append)
    for number in (1, 2):
        mishaps(caught(number))
    (event,) = told
    assert (event.time, event.kind, event.level) == (7, "mishap", Level.ERROR)
    assert event.text.startswith("a fault of this program at ")
    assert event.text.endswith("test_mishaps.py:6: ZeroDivisionError: divided 1; the robot goes on, please report it")
    assert capsys.readouterr().err == ""


def test_the_traceback_is_for_those_who_ask(capsys, monkeypatch):
    monkeypatch.setenv("CANOPEN_CONTROL_DEBUG", "1")
    Mishaps(lambda: 0, lambda _event: None)(caught(1))
    assert "Traceback" in capsys.readouterr().err


def test_an_exception_without_a_place_and_a_storm_of_places_do_no_harm():
    told = []
    mishaps = Mishaps(lambda: 0, told.append)
    mishaps(ValueError("from nowhere"))
    assert "at an unknown place: ValueError: from nowhere" in told[0].text
    for line in range(1, 100):
        code = compile("\n" * line + "1 / 0", "x.py", "eval")
        try:
            eval(code)
        except ZeroDivisionError as error:
            mishaps(error)
    assert len(told) == 20
