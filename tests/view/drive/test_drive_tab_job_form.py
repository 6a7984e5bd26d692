import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from nicegui import ui
from support.pages import seen, visited

from canopen_control.commissioning.jobs import FIRMWARE, RESTORE, ProgramOptions, Reached, RestoreOptions
from canopen_control.errors import ConfigError
from canopen_control.view.drive.drive_tab import JobForm


def played(job, act):
    async def play(_user, form):
        return act(form)

    return visited(lambda: JobForm(job), play)


def test_the_inputs_are_those_of_the_verb():
    def act(form):
        return [each.text for each in seen(ui.checkbox)], form.options()

    texts, options = played(RESTORE, act)
    assert texts == [one.text for one in RESTORE.declared.values() if one.is_switch]
    assert options == RestoreOptions(protect=[])


def test_what_is_filled_in_is_read_as_the_verb_reads_it():
    def act(form):
        form.inputs["store"].value, form.inputs["protect"].value = True, "0x2*, Home offset"
        return form.options(reached=Reached(robot="robby"))

    assert played(RESTORE, act) == RestoreOptions(["0x2*", "Home offset"], store=True, reached=Reached(robot="robby"))


def test_a_number_and_an_empty_input():
    def act(form):
        form.inputs["number"].value, form.inputs["expected"].value = "0x2", ""
        options = form.options()
        form.inputs["number"].value = "300"
        with pytest.raises(ConfigError, match="'300' is not a number of a program: 1 to 254"):
            form.options()
        return options

    assert played(FIRMWARE, act) == ProgramOptions(2)
