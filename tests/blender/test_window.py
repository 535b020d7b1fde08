"""The add-on while gcnd runs beside Blender: progress, Esc, and a mesh that changes meanwhile.

Without a window Blender sends no events, so window, timer and events are played by a stand-in.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from blender_scene import ID, UP, bpy, co, module, read


class Window:
    """Stands in for what Blender gives an operator that has a window."""

    def __init__(self) -> None:
        self.window, self.timers, self.status = object(), [], None
        self.window_manager = self.workspace = self
        self.windows: list[Any] = []

    @property
    def active_object(self) -> Any:
        return bpy.context.active_object

    def event_timer_add(self, seconds: float, window: Any) -> float:
        assert window is self.window
        self.timers.append(seconds)
        return seconds

    def event_timer_remove(self, timer: float) -> None:
        self.timers.remove(timer)

    def modal_handler_add(self, operator: Any) -> None:
        self.operator = operator

    def status_text_set(self, text: str | None) -> None:
        self.status = text


TIMER = SimpleNamespace(type="TIMER", value="NOTHING")
ESC = SimpleNamespace(type="ESC", value="PRESS")
MOUSE = SimpleNamespace(type="MOUSEMOVE", value="NOTHING")


class Held:
    """A run of the add-on that waits until it is let go or stopped."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.go = threading.Event()
        monkeypatch.setattr(module("runs").PythonRun, "_denoised", lambda run: self.wait(run))

    def wait(self, run: Any) -> np.ndarray:
        run.fraction, run.stage = 0.4, "normals"
        while not self.go.wait(0.01) and not run._stopping.is_set():
            continue
        return run.mesh.positions + UP


@pytest.fixture
def held(ball: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Held]:
    yield Held(monkeypatch)
    module("denoising").stop()


def started(name: str) -> tuple[Any, Window, list[Any]]:
    """Presses a button in a stand-in window: what it does, without Blender's base, which only Blender can make."""
    told: list[Any] = []
    base = getattr(module("denoising"), {"preview": "Previewing", "apply": "Applying"}[name])
    operator = type(name, (base,), {"report": lambda self, kind, text: told.append((kind, text))})()
    window = Window()
    assert operator.invoke(window, None) == {"RUNNING_MODAL"}
    assert window.operator is operator
    assert window.timers == [0.1]
    return operator, window, told


def ended(operator: Any, window: Window) -> set[str]:
    until = time.monotonic() + 20
    while time.monotonic() < until:
        answer: set[str] = operator.modal(window, TIMER)
        if answer != {"PASS_THROUGH"}:
            assert (window.timers, window.status) == ([], None)
            assert module("denoising").running() is None
            return answer
        time.sleep(0.01)
    raise AssertionError("the operator did not end")


@pytest.mark.parametrize("name", ["preview", "apply"])
def test_blender_goes_on_while_gcnd_runs(ball: Any, held: Held, name: str) -> None:
    mesh, before = ball.data, co(ball)
    operator, window, told = started(name)
    run, until = module("denoising").running().run, time.monotonic() + 20
    while run.stage != "normals" and time.monotonic() < until:
        time.sleep(0.01)
    assert operator.modal(window, MOUSE) == {"PASS_THROUGH"}
    assert window.status is None
    assert operator.modal(window, TIMER) == {"PASS_THROUGH"}
    assert window.status == "gcnd: normals, 40%; Esc stops it"
    assert not bpy.ops.gcnd.apply.poll()
    assert not bpy.ops.gcnd.preview.poll()
    assert np.array_equal(co(ball), before)
    held.go.set()
    assert ended(operator, window) == {"FINISHED"}
    assert told == [({"INFO"}, "482 of 482 vertices moved, 0.5 at most")]
    assert np.array_equal(co(ball), before + UP)
    assert (ball.data == mesh) is (name == "apply")


def test_esc_stops_and_nothing_changes(ball: Any, held: Held) -> None:
    before = co(ball)
    operator, window, told = started("apply")
    assert operator.modal(window, ESC) == {"RUNNING_MODAL"}
    assert ended(operator, window) == {"CANCELLED"}
    assert told == [({"INFO"}, "gcnd was stopped; nothing was changed")]
    assert np.array_equal(co(ball), before)
    assert bpy.ops.gcnd.apply.poll()


def moved_vertex(ball: Any) -> None:
    ball.data.vertices[0].co.x += 1.0


def new_name(ball: Any) -> None:
    ball.name = "other"


def removed(ball: Any) -> None:
    bpy.data.objects.remove(ball)


@pytest.mark.parametrize("change", [moved_vertex, new_name, removed])
def test_a_mesh_that_changed_while_gcnd_ran_is_not_overwritten(
    ball: Any, held: Held, change: Callable[[Any], None]
) -> None:
    mesh = ball.data
    operator, window, told = started("apply")
    change(ball)
    before = read(mesh.vertices, "co", 3)
    held.go.set()
    assert ended(operator, window) == {"CANCELLED"}
    assert told == [({"ERROR"}, "Sphere was changed while gcnd ran\nHint: start again")]
    assert np.array_equal(read(mesh.vertices, "co", 3), before)


def test_opening_another_file_stops_the_run(ball: Any, held: Held) -> None:
    operator, window, told = started("preview")
    run = module("denoising").running().run
    operator.cancel(window)
    assert run.is_done()
    assert (window.timers, window.status, told) == ([], None, [])
    assert module("denoising").running() is None


def test_switching_the_add_on_off_stops_the_run(ball: Any, held: Held) -> None:
    started("preview")
    run = module("denoising").running().run
    bpy.ops.preferences.addon_disable(module=ID)
    assert run.is_done()
    assert not hasattr(bpy.types.Object, "gcnd_denoise")
    bpy.ops.preferences.addon_enable(module=ID)
    assert ball.gcnd_denoise.strength == 1.0
