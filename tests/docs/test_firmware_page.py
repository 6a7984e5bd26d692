"""The page on firmware, followed: its drive, its program, its commands, one after the other."""

import re

import pytest
from support.documents import DOCS, code_blocks

from canopen_control.cli.main import main

PAGE = DOCS / "guide" / "firmware.md"


@pytest.mark.process
def test_the_commands_of_the_page_load_its_program_until_the_flash_fails(stage, monkeypatch, capsys):
    monkeypatch.chdir(stage.place)
    lines = re.findall(r"^    canopen-control (.*local:desk.*)$", PAGE.read_text(), re.MULTILINE)
    drive, firmware, fault = (line.split() for line in lines)
    (program,) = code_blocks(PAGE, "python")
    exec(program, {})
    stage.start(*drive).until("ready on")
    assert main(firmware) == 0
    assert capsys.readouterr().out.endswith(" of 2026-11-24 14:30:00\n")
    assert main(fault) == 0
    assert main(firmware) == 1
    assert "flash write error" in capsys.readouterr().err
