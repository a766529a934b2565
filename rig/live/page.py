"""Layout of the page with NiceGUI; `static/live.js` fills it from the stream."""

from __future__ import annotations

from fastapi import Request
from nicegui import ui

from rig.live.authentication import VISITOR, Visitor

HEAD = '<link rel="stylesheet" href="/live/live.css"><script type="module" src="/live/live.js"></script>'


def define() -> None:
    """Register the page."""

    @ui.page("/", title="softrig")
    def index(request: Request) -> None:
        visitor: Visitor = request.scope[VISITOR]
        ui.add_head_html(HEAD)
        ui.colors(primary="#0072b2", warning="#8a5a00", negative="#b3261e")
        with ui.element("main").props("id=softrig"):
            _header()
            _prompt(visitor)
            with ui.element("div").props("id=board"):
                _numbers()
                _panels()
            _actions(visitor)


def _part(tag: str, name: str, text: str = "", label: str = "") -> ui.element:
    element = ui.element(tag).props(f"id={name}")
    if label:
        element.props(f'aria-label="{label}" role=img')
    if text:
        with element:
            ui.html(text, sanitize=False, tag="span")
    return element


def _header() -> None:
    with ui.element("header"):
        _part("h1", "title")
        _part("span", "simulated", "SIMULATED")
        _part("span", "state", "connecting")
        _part("span", "segment")
        with _part("div", "progress").props("role=progressbar aria-label=protocol"):
            _part("div", "progress-bar")
        _part("span", "clock")
        _part("span", "who")
        ui.button("light / dark").props("id=theme flat no-caps dense")
    with _part("div", "banner").props("role=alert hidden"):
        _part("span", "banner-text")
        for name in ("report", "archive"):
            ui.html(name, sanitize=False, tag="a").props(
                f"id=link-{name} href=/live/results/{name} target=_blank hidden"
            )


def _prompt(visitor: Visitor) -> None:
    with _part("div", "prompt").props("hidden role=alert"):
        _part("span", "prompt-text")
        if visitor.operator:
            ui.button("Done").props("data-do=answer unelevated no-caps")


def _numbers() -> None:
    with ui.element("section").props("id=numbers aria-label=numbers"):
        for name, title, unit in (
            ("error", "model error", "mm"),
            ("pressure", "pressure", "bar"),
        ):
            with ui.element("div").classes("tile").props(f"id=tile-{name}"):
                ui.html(title, sanitize=False, tag="h2").props(f"id={name}-title")
                with ui.element("p").classes("big"):
                    _part("span", name, "–")
                    ui.html(unit, sanitize=False, tag="small")
                _part("p", f"{name}-more")


def _panels() -> None:
    with ui.element("section").props("id=panels"):
        with _panel("camera", "camera"):
            _part("canvas", "picture", label="camera picture with the board, the measured tip and the model's tip")
            ui.html(
                '<i class="mark tip"></i> measured <i class="mark model"></i> model <i class="mark board"></i> board',
                sanitize=False,
            ).classes("legend")
        with _panel("plane", "tip in the plane of motion, r and z [mm]"):
            ui.echart({"series": []}).classes("chart chart-plane")
        with _panel("arm", "arm with sections; drag to turn"):
            _part("canvas", "arm-view", label="the arm's axis and actuators in space")
        with _panel("pressures", "pressures [bar], set-points dashed"):
            ui.echart({"series": []}).classes("chart chart-pressure")
        with _panel("coordinates", "tip r, z over time [mm], 95 % band"):
            ui.echart({"series": []}).classes("chart chart-tip")
        with _panel("errors", "error [mm] and its running mean"):
            ui.echart({"series": []}).classes("chart chart-error")
        with _panel("events", "events"):
            _part("ol", "event-list")
        with _panel("estimates", "estimated beside the run, never used for control").props("hidden"):
            _part("table", "estimate-rows")
        with _panel("timing", "timing, sections and auxiliary inputs"):
            _part("dl", "health")


def _panel(name: str, title: str) -> ui.element:
    panel = ui.element("article").props(f"id=panel-{name}")
    with panel:
        ui.html(title, sanitize=False, tag="h2")
    return panel


def _actions(visitor: Visitor) -> None:
    with ui.element("footer"):
        if not visitor.operator:
            ui.html("View only.", sanitize=False)
            return
        _button("pause", "Pause", "primary")
        _button("skip", "Skip segment", "primary")
        _part("span", "answer").props("role=status")
        _button("stop", "Stop", "warning")
        _button("vent", "VENT", "negative")


def _button(name: str, text: str, colour: str) -> ui.button:
    return ui.button(text, color=colour).props(f"id={name} data-do={name} unelevated no-caps")
