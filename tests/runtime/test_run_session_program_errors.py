from canopen_control.master.event_log import Level
from canopen_control.runtime.run_session import ProgramErrors


def broken(number):
    raise ZeroDivisionError(f"divided {number}")


def caught(number):
    try:
        broken(number)
    except ZeroDivisionError as error:
        return error


def test_a_fault_of_the_program_is_an_event_with_its_place_and_reported_once(capsys):
    reports = []
    program_errors = ProgramErrors(lambda: 7, reports.append)
    for number in (1, 2):
        program_errors(caught(number))
    (event,) = reports
    assert (event.time, event.kind, event.level) == (7, "program_error", Level.ERROR)
    assert event.text.startswith("an error in this program at ")
    assert event.text.endswith(
        "test_run_session_program_errors.py:6: ZeroDivisionError: divided 1; the robot continues "
        "unless every cycle raises one; please report the error"
    )
    assert capsys.readouterr().err == ""


def test_the_traceback_is_printed_on_request(capsys, monkeypatch):
    monkeypatch.setenv("CANOPEN_CONTROL_DEBUG", "1")
    ProgramErrors(lambda: 0, lambda _event: None)(caught(1))
    assert "Traceback" in capsys.readouterr().err


def test_an_exception_without_a_place_and_a_storm_of_places_do_no_harm():
    reports = []
    program_errors = ProgramErrors(lambda: 0, reports.append)
    program_errors(ValueError("from nowhere"))
    assert "at an unknown place: ValueError: from nowhere" in reports[0].text
    for line in range(1, 100):
        code = compile("\n" * line + "1 / 0", "x.py", "eval")
        try:
            eval(code)
        except ZeroDivisionError as error:
            program_errors(error)
    assert len(reports) == 20
