from canopen_control.cli.table import Table


def test_columns_are_as_wide_as_their_widest_cell_and_numbers_stand_right():
    table = Table(("name", "value"))
    table.add(("left", "-1.5"))
    table.add(("right_drive", "100.25"))
    assert table.lines() == ["name         value", "left           -1.5", "right_drive  100.25"]


def test_a_missing_value_stands_left():
    table = Table(("name", "value"))
    table.add(("a", "-"))
    assert table.lines() == ["name  value", "a     -"]
