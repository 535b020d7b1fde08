"""Charts of a comparison: bars of mean E_a by kind and level, and time against accuracy."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from gcnd.compare.summary import ALL, Line
from gcnd.page import inline_svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["bar_chart", "time_chart"]

_LEVEL_COLOURS = ("#9db4c0", "#e0a458", "#c8553d", "#6b2d5c", "#3d5a40", "#555555")
_OWN, _OTHER = "#c8553d", "#7d8aa5"


def bar_chart(lines: Sequence[Line], noise: str) -> str:
    """Draws mean E_a of each method, one panel a kind and one bar a level.

    Args:
        lines: Of `gcnd.compare.summary.summarise`.
        noise: Kind of noise.

    Returns:
        SVG to stand in a page; empty when no line has an E_a.
    """
    from matplotlib.figure import Figure

    own = [line for line in lines if line.noise == noise and line.e_a is not None]
    if not own:
        return ""
    kinds = _names(line.kind for line in own)
    # The only kind says the same as all of them.
    kinds = [kind for kind in kinds if kind != ALL] if len(kinds) == 2 else kinds
    levels = [level for level in _names(line.level for line in own) if level != ALL]
    whole = [line for line in own if (line.kind, line.level) == (ALL, ALL)]
    methods = [line.method for line in whole]
    height = 0.16 * len(methods) * max(len(levels), 1) + 0.2 * len(methods) + 1.2
    figure = Figure(figsize=(3.4 * len(kinds) + 2.2, height), layout="constrained")
    panels = figure.subplots(1, len(kinds), squeeze=False, sharey=True)[0]
    for axes, kind in zip(panels, kinds, strict=True):
        values = {(line.method, line.level): line.e_a or 0.0 for line in own if line.kind == kind}
        _bars(axes, methods, levels, values)
        axes.set_title("all kinds" if kind == ALL else kind, fontsize=11, parse_math=False)
        axes.set_xlabel("E_a, degrees")
    panels[0].invert_yaxis()
    handles, labels = panels[0].get_legend_handles_labels()
    legend = figure.legend(handles, labels, loc="outside upper center", ncols=len(levels), frameon=False)
    for text in legend.get_texts():
        text.set_parse_math(False)
    return inline_svg(figure)


def _bars(
    axes: Axes, methods: Sequence[str], levels: Sequence[str], values: dict[tuple[str, str], float]
) -> None:
    step = 0.84 / max(len(levels), 1)
    for slot, level in enumerate(levels):
        places = [row + (slot - (len(levels) - 1) / 2) * step for row in range(len(methods))]
        widths = [values.get((method, level), 0.0) for method in methods]
        colour = _LEVEL_COLOURS[slot % len(_LEVEL_COLOURS)]
        bars = axes.barh(places, widths, step * 0.9, color=colour, label=f"noise {level}")
        axes.bar_label(bars, [f"{width:.2f}" if width else "–" for width in widths], fontsize=7, padding=2)
    axes.set_yticks(range(len(methods)), methods, fontsize=9, parse_math=False)
    axes.spines[["top", "right"]].set_visible(False)
    axes.margins(x=0.15, y=0.01)


def time_chart(lines: Sequence[Line], own_labels: Sequence[str]) -> str:
    """Draws mean E_a against the seconds for a million faces; numbers stand for methods, as listed beside them.

    Args:
        lines: Of one noise, kind and level; those without time are left out, and those that are no one method.
        own_labels: Labels of gcnd's own methods, which get a colour of their own.

    Returns:
        SVG to stand in a page; empty when no line has a time.
    """
    from matplotlib.figure import Figure

    timed = [
        line for line in lines if line.e_a is not None and line.seconds_per_million and not line.is_choice
    ]
    if not timed:
        return ""
    figure = Figure(figsize=(11, max(4.5, 0.2 * len(timed) + 1)), layout="constrained")
    axes, legend = figure.subplots(1, 2, width_ratios=(3, 1))
    legend.set_axis_off()
    for number, line in enumerate(timed, start=1):
        colour = _OWN if line.method in own_labels else _OTHER
        x, y = line.seconds_per_million or 0.0, line.e_a or 0.0
        axes.scatter(x, y, s=150, color=colour, edgecolor="white", linewidth=0.8, zorder=2)
        text = {"ha": "center", "va": "center_baseline", "fontsize": 7, "color": "white"}
        axes.annotate(str(number), (x, y), **text)
        place = 1 - (number - 0.5) / len(timed)
        name = f"{number}  {line.method}"
        looks = {"fontsize": 9, "color": colour, "va": "center", "parse_math": False}
        legend.text(0, place, name, transform=legend.transAxes, **looks)
    axes.set_xscale("log")
    axes.margins(0.08)
    axes.set_xlabel("seconds for a million faces")
    axes.set_ylabel("mean E_a, degrees")
    axes.grid(alpha=0.3, which="both")
    axes.spines[["top", "right"]].set_visible(False)
    return inline_svg(figure)


def _names(values: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(values))
