import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from nicegui import ui
from support.pages import seen, visited

from canopen_control.commissioning.jobs import FIRMWARE, RESTORE, ProgramOptions, Reached, RestoreOptions
from canopen_control.errors import ConfigError
from canopen_control.view.drive.drive_tab import JobForm


async def test_the_inputs_are_those_of_the_verb():
    async with visited(lambda: JobForm(RESTORE)) as (_user, form):
        assert [item.text for item in seen(ui.checkbox)] == [
            one.text for one in RESTORE.declared.values() if one.is_switch
        ]
        assert form.options() == RestoreOptions(protect=[])


async def test_what_is_filled_in_is_read_as_the_verb_reads_it():
    reached = Reached(robot="robby")
    async with visited(lambda: JobForm(RESTORE)) as (_user, form):
        form.inputs["store"].value, form.inputs["protect"].value = True, "0x2*, Home offset"
        assert form.options(reached=reached) == RestoreOptions(["0x2*", "Home offset"], store=True, reached=reached)


async def test_a_number_and_an_empty_input():
    async with visited(lambda: JobForm(FIRMWARE)) as (_user, form):
        form.inputs["number"].value, form.inputs["expected"].value = "0x2", ""
        assert form.options() == ProgramOptions(2)
        form.inputs["number"].value = "300"
        with pytest.raises(ConfigError, match="'300' is not a number of a program: 1 to 254"):
            form.options()
