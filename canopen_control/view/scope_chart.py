"""Scope captures and frequency responses as options of ECharts charts, without NiceGUI.

A capture has a plot per unit, with an overlay in grey and cursors. The data are thinned to `MAX_POINTS` for each
signal by sending the smallest and the greatest value of each time interval, so that no peak is lost; files contain
every sample.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from canopen_control.commissioning.frequency_response import Bode
    from canopen_control.commissioning.scope_capture import NamedShot, Shot


MAX_POINTS: Final = 2400
_FIELD, _GAP, _TOP, _BOTTOM = 150, 44, 50, 40  # pixels
_COLORS: Final = ("#1d5fd1", "#d1491d", "#1f8a4c", "#8a3fc0", "#b07d00", "#0097a7", "#c2185b", "#5d4037")
_OVERLAY: Final = "#9aa5b1"
Json: TypeAlias = "bool | int | float | str | Sequence[Json] | Mapping[str, Json] | None"
Options: TypeAlias = dict[str, Json]
_TIME_LABEL: Final[Options] = {
    "fontSize": 11,
    "showMinLabel": False,
    "showMaxLabel": False,
}  # hidden, because the ends are not round numbers
_LINE: Final[Options] = {"color": "#16324f", "width": 1, "type": "solid"}


def thinned(shot: Shot, place: int, most: int = MAX_POINTS) -> list[tuple[float, float | None]]:
    """Return at most about `most` points of a signal, as pairs of time since the capture's zero and value."""
    points = [(round(time - shot.zero, 6), _known(row[place])) for time, row in shot.rows]
    if len(points) <= most:
        return points
    stretch = math.ceil(2 * len(points) / most)
    kept_points = []
    for begin in range(0, len(points), stretch):
        valid = [point for point in points[begin : begin + stretch] if point[1] is not None]
        if not valid:
            kept_points.append(points[begin])
            continue
        ends = (min(valid, key=lambda point: point[1] or 0.0), max(valid, key=lambda point: point[1] or 0.0))
        kept_points += sorted(set(ends))
    return kept_points


def _known(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else value


def height_of(named: NamedShot) -> int:
    """Return the height of a capture's chart in pixels."""
    return _TOP + _BOTTOM + len(_fields(named)) * (_FIELD + _GAP)


def chart_options(named: NamedShot, overlay: NamedShot | None, cursors: tuple[float, float] | None) -> Options:
    """Return the ECharts options for a capture, with an overlay of the same signals, and cursors at two times."""
    fields = _fields(named)
    low, high = named.shot.time_range
    axes = range(len(fields))
    series: list[Options] = []
    for place, name in enumerate(named.names):
        number = fields.index(_unit(named, place))
        if overlay is not None and (overlay_place := overlay.place(name)) is not None:
            label = f"{name} ({overlay.label or 'overlay'})"
            series.append(_series(f"o{place}", label, overlay.shot, overlay_place, number, _OVERLAY))
        series.append(_series(f"s{place}", name, named.shot, place, number, _COLORS[place % len(_COLORS)]))
    return {
        "animation": False,
        "legend": {"type": "scroll", "top": 0, "textStyle": {"fontSize": 12}},
        "tooltip": {"trigger": "axis", "confine": True},
        "axisPointer": {"link": [{"xAxisIndex": "all"}]},
        "grid": [
            {"left": 64, "right": 18, "top": _TOP + number * (_FIELD + _GAP), "height": _FIELD} for number in axes
        ],
        "xAxis": [
            {"type": "value", "gridIndex": number, "min": low, "max": high, "axisLabel": _TIME_LABEL} for number in axes
        ],
        "yAxis": [
            {
                "type": "value",
                "gridIndex": number,
                "scale": True,
                "name": unit,
                "nameTextStyle": {"fontSize": 11, "align": "left"},
                "axisLabel": {"fontSize": 11},
            }
            for number, unit in enumerate(fields)
        ],
        "dataZoom": [
            {"type": "inside", "xAxisIndex": list(axes), "filterMode": "none"},
            {"type": "slider", "xAxisIndex": list(axes), "filterMode": "none", "bottom": 8, "height": 20},
        ],
        "series": [*series, *_marks(named, cursors)],
    }


def bode_options(bode: Bode) -> Options:
    """Return the ECharts options for two plots: gain and phase over frequency."""
    fields = (("gain, dB", _COLORS[0]), ("phase, degrees", _COLORS[1]))
    values = ([(p.frequency, p.gain) for p in bode.points], [(p.frequency, p.phase) for p in bode.points])
    return {
        "animation": False,
        "tooltip": {"trigger": "axis", "confine": True},
        "axisPointer": {"link": [{"xAxisIndex": "all"}]},
        "grid": [
            {"left": 64, "right": 18, "top": _TOP + number * (_FIELD + _GAP), "height": _FIELD} for number in (0, 1)
        ],
        "xAxis": [
            {
                "type": "log",
                "gridIndex": number,
                "name": "Hz",
                "min": "dataMin",
                "max": "dataMax",
                "axisLabel": _TIME_LABEL,
            }
            for number in (0, 1)
        ],
        "yAxis": [
            {"type": "value", "gridIndex": number, "scale": True, "name": title, "nameTextStyle": {"align": "left"}}
            for number, (title, _) in enumerate(fields)
        ],
        "series": [
            {
                "id": f"b{number}",
                "name": title,
                "type": "line",
                "showSymbol": False,
                "xAxisIndex": number,
                "yAxisIndex": number,
                "lineStyle": {"width": 1.4, "color": color},
                "itemStyle": {"color": color},
                "data": values[number],
            }
            for number, (title, color) in enumerate(fields)
        ],
    }


BODE_HEIGHT: Final = _TOP + _BOTTOM + 2 * (_FIELD + _GAP)


def cursor_change(named: NamedShot, cursors: tuple[float, float] | None) -> Options:
    """Return the ECharts options for the new cursor positions after the user has moved a cursor."""
    return {"series": _marks(named, cursors)}


def _marks(named: NamedShot, cursors: tuple[float, float] | None) -> list[Options]:
    marks: list[Options] = [{"xAxis": at, "name": label} for at, label in zip(cursors or (), ("1", "2"), strict=False)]
    if named.shot.triggered is not None:
        marks.append({"xAxis": 0.0, "name": "T"})
    return [
        {
            "id": f"marks{number}",
            "type": "line",
            "data": [],
            "xAxisIndex": number,
            "yAxisIndex": number,
            "markLine": {
                "silent": True,
                "symbol": "none",
                "precision": 9,  # without it ECharts rounds cursors to hundredths of a second
                "animation": False,
                "label": {"formatter": "{b}", "fontSize": 11, "position": "end"},
                "lineStyle": _LINE,
                "data": marks,
            },
        }
        for number in range(len(_fields(named)))
    ]


def _fields(named: NamedShot) -> list[str]:
    """Return the distinct units; signals with the same unit share a plot."""
    return list(dict.fromkeys(_unit(named, place) for place in range(len(named.names))))


def _unit(named: NamedShot, place: int) -> str:
    return named.units[place] if place < len(named.units) else ""


def _series(key: str, name: str, shot: Shot, place: int, field: int, color: str) -> Options:
    return {
        "id": key,
        "name": name,
        "type": "line",
        "step": "end",
        "showSymbol": False,
        "xAxisIndex": field,
        "yAxisIndex": field,
        "lineStyle": {"width": 1.4, "color": color},
        "itemStyle": {"color": color},
        "data": thinned(shot, place),
    }
