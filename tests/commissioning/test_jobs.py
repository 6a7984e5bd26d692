import pytest

from canopen_control.commissioning.jobs import (
    CLONE,
    FIRMWARE,
    JOBS,
    RESTORE,
    JobRun,
    ProgramDate,
    options_of,
    parse_date,
)
from canopen_control.errors import ConfigError, DriveError


def test_an_option_has_a_flag_a_text_and_a_reader():
    declared = options_of(FIRMWARE.options)
    assert [one.flag for one in declared.values()] == ["--program", "--expect", "--expect-date", "--confirm"]
    assert all(one.text for job in JOBS.values() for one in job.declared.values())
    assert (declared["number"].value_of(" 2 "), declared["number"].value_of("")) == (2, 1)
    assert declared["confirm"].is_switch
    assert options_of(RESTORE.options)["protect"].value_of("0x2*, Home offset,") == ["0x2*", "Home offset"]


def test_a_job_leaves_out_the_options_that_it_has_no_use_for():
    assert RESTORE.declared.keys() - CLONE.declared.keys() == {"any_node"}


def test_the_line_of_a_job_names_its_options():
    assert FIRMWARE.asks == "FILE; also --program=N, --expect=ID, --expect-date=DAY[TTIME], --confirm"
    assert JOBS["backup"].asks == "FILE.dcf"


def test_a_date_is_a_day_with_or_without_a_time():
    assert str(parse_date("2026-11-21")) == "2026-11-21"
    date = parse_date("2026-11-21T14:30:00.5")
    assert (date.milliseconds, str(date)) == (((14 * 60 + 30) * 60) * 1000 + 500, "2026-11-21 14:30:00")
    assert ProgramDate(date.day).fits(date)
    assert not date.fits(ProgramDate(date.day))
    for wrong in ("yesterday", "2026-02-30", "2026-11-21T25:00"):
        with pytest.raises(ConfigError, match="is not a date: 2026-11-21, or"):
            parse_date(wrong)


def test_a_part_restarts():
    run = JobRun(RESTORE, "Restoring a.dcf")
    run.part("reading", "objects")
    run.at(3, 4)
    run.part("writing", "groups")
    assert (run.doing, run.unit, run.done, run.total) == ("writing", "groups", 0, None)


def test_a_run_that_is_asked_to_end_ends_at_its_next_step():
    run = JobRun(RESTORE, "Restoring a.dcf")
    run.end()
    with pytest.raises(DriveError, match="a page requested the end"):
        run.at(2, 2)
    assert (run.done, run.over) == (2, False)
