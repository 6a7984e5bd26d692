from rich.style import Style

from canopen_control.monitor.picture import Tone
from canopen_control.monitor.style import MARK_STYLES, TONE_STYLES
from canopen_control.trace.decoder import Mark


def test_every_tone_and_every_mark_has_a_style_that_rich_knows():
    assert set(TONE_STYLES) == set(Tone)
    assert set(MARK_STYLES) == set(Mark)
    for style in [*TONE_STYLES.values(), *MARK_STYLES.values()]:
        Style.parse(style)
