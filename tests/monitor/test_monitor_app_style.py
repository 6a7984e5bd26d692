from rich.style import Style

from canopen_control.monitor.monitor_app import MARK_STYLES, TONE_STYLES, tone_styles
from canopen_control.monitor.monitor_content import Tone
from canopen_control.trace.decoder import Mark


def test_every_tone_and_every_mark_has_a_style_that_rich_knows():
    assert set(TONE_STYLES) == set(Tone)
    assert set(MARK_STYLES) == set(Mark)
    for style in [*TONE_STYLES.values(), *MARK_STYLES.values()]:
        Style.parse(style)


def test_no_color_leaves_no_colour_and_bad_still_stands_out():
    plain = tone_styles({"NO_COLOR": "1"})
    assert set(plain) == set(Tone)
    assert all(Style.parse(style).color is None for style in plain.values())
    assert plain[Tone.BAD] not in {style for tone, style in plain.items() if tone is not Tone.BAD}
    assert Style.parse(tone_styles({})[Tone.BAD]).color is not None
