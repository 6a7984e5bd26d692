import re

from canopen_control.view.style import ICONS, STYLE


def test_the_style_asks_nobody_for_anything():
    assert "url(" not in STYLE
    assert "@import" not in STYLE
    assert "http" not in STYLE


def test_every_icon_that_is_styled_is_one_that_a_button_has():
    styled = set(re.findall(r"icon-tabler-([a-z-]+)", STYLE))
    assert styled <= set(ICONS.values())
    assert "hand-stop" in styled


def test_it_is_one_element_with_balanced_braces():
    assert STYLE.startswith("<style>")
    assert STYLE.endswith("</style>")
    assert STYLE.count("{") == STYLE.count("}") > 10
