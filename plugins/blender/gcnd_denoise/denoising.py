"""What the buttons Preview and Apply do: one run of gcnd, with Blender going on beside it."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import bpy
import numpy as np

from . import meshes, preview
from .arrays import blended, check, moved_text
from .errors import Failure, Stopped
from .runs import Run
from .settings import preferences

__all__ = ["Applying", "Previewing", "running", "stop"]

_POLL_SECONDS = 0.1


class Job(NamedTuple):
    """A run and the names of what it is for: undo replaces Blender's objects, so none is held."""

    run: Run
    object_name: str
    mesh_name: str

    def target(self) -> bpy.types.Object:
        """Finds the object again.

        Raises:
            Failure: It or its mesh is gone, or was edited.
        """
        obj = bpy.data.objects.get(self.object_name)
        if obj is not None and obj.type == "MESH" and preview.own_mesh(obj).name == self.mesh_name:
            meshes.check_object(obj)
            if np.array_equal(meshes.positions(preview.own_mesh(obj)), self.run.mesh.positions):
                return obj
        raise Failure(f"{self.object_name} was changed while gcnd ran", "start again")


_jobs: list[Job] = []
"""The one job at work, or none."""


def running() -> Job | None:
    """Returns the job at work."""
    return _jobs[0] if _jobs else None


def stop() -> None:
    """Stops the job at work and waits for its end."""
    for job in _jobs:
        job.run.stop()
        job.run.wait()
    _jobs.clear()


class Denoising:
    """Runs gcnd on the active object: beside Blender's own work from the panel, and waiting for it from a script."""

    bl_options: ClassVar[set[str]] = {"UNDO"}
    timer = None

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Allows one run at a time."""
        if running():
            cls.poll_message_set("gcnd is running; Esc stops it")
        return running() is None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Runs to the end, as scripts want it."""
        return self.finish(context) if self.begin(context) else {"CANCELLED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Starts and lets Blender go on."""
        if not self.begin(context):
            return {"CANCELLED"}
        self.timer = context.window_manager.event_timer_add(_POLL_SECONDS, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Stops on Esc, shows how far the run is, and ends with it."""
        job = running()
        if job is None:
            self.leave(context)
            return {"CANCELLED"}
        if event.type == "ESC" and event.value == "PRESS":
            job.run.stop()
            return {"RUNNING_MODAL"}
        if event.type == "TIMER":
            if job.run.is_done():
                self.leave(context)
                return self.finish(context)
            context.workspace.status_text_set(f"gcnd: {job.run.stage}, {job.run.fraction:.0%}; Esc stops it")
            redraw(context)
        return {"PASS_THROUGH"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Stops the run when Blender ends the operator, as when another file is opened."""
        self.leave(context)
        stop()

    def leave(self, context: bpy.types.Context) -> None:
        """Takes back what ``invoke`` and ``modal`` put into the window."""
        if self.timer is not None:
            context.window_manager.event_timer_remove(self.timer)
            self.timer = None
        context.workspace.status_text_set(None)
        redraw(context)

    def begin(self, context: bpy.types.Context) -> bool:
        """Checks the active object and starts a run on it; tells what is in the way."""
        try:
            obj = meshes.check_object(context.active_object)
            settings, mesh = obj.gcnd_denoise, preview.own_mesh(obj)
            meshes.kept_vertices(obj, mesh, settings.keep)
            triangles = meshes.triangles(mesh)
            check(triangles)
            if not settings.preset:
                raise Failure("No preset is chosen", "choose one in the panel")
            run = preferences().make_run(triangles, settings.preset)
        except Failure as failure:
            self.report({"ERROR"}, failure.text())
            return False
        run.start()
        _jobs.append(Job(run, obj.name, mesh.name))
        return True

    def finish(self, context: bpy.types.Context) -> set[str]:
        """Waits for the run, uses its result, and tells what it did."""
        job = _jobs[0]
        try:
            after = job.run.result()
            obj = job.target()
            text, notes = self.use(obj, after), self.notes(obj)
        except Stopped:
            self.report({"INFO"}, "gcnd was stopped; nothing was changed")
            return {"CANCELLED"}
        except Failure as failure:
            self.report({"ERROR"}, failure.text())
            return {"CANCELLED"}
        finally:
            _jobs.clear()
        self.report({"WARNING" if notes else "INFO"}, "; ".join([text, *notes]))
        return {"FINISHED"}

    def notes(self, obj: bpy.types.Object) -> list[str]:
        """Says what the user may not expect of the result."""
        return meshes.notes(obj)


class Previewing(Denoising):
    """Shows the denoised mesh."""

    def use(self, obj: bpy.types.Object, after: np.ndarray) -> str:
        """Shows the result."""
        return preview.show(obj, after)


class Applying(Denoising):
    """Moves the mesh's vertices."""

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Takes the preview if there is one, else runs to the end."""
        return self.taken(context) or super().execute(context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Takes the preview if there is one, else starts a run."""
        return self.taken(context) or super().invoke(context, event)

    def taken(self, context: bpy.types.Context) -> set[str] | None:
        """Applies the preview of the active object; None where there is none."""
        obj = context.active_object
        if obj is None or not preview.is_shown(obj):
            return None
        try:
            text = preview.apply(meshes.check_object(obj))
        except Failure as failure:
            self.report({"ERROR"}, failure.text())
            return {"CANCELLED"}
        notes = self.notes(obj)
        self.report({"WARNING" if notes else "INFO"}, "; ".join([text, *notes]))
        return {"FINISHED"}

    def use(self, obj: bpy.types.Object, after: np.ndarray) -> str:
        """Writes the result into the mesh."""
        mesh = obj.data
        before, keep = meshes.positions(mesh), meshes.kept_vertices(obj, mesh, obj.gcnd_denoise.keep)
        moved = blended(before, after, obj.gcnd_denoise.strength, keep)
        meshes.write(mesh, moved)
        return moved_text(before, moved)

    def notes(self, obj: bpy.types.Object) -> list[str]:
        """Adds to the others that more objects than one have changed."""
        n_objects = meshes.sharing(obj.data)
        shared = [f"the mesh is shared: {n_objects} objects have changed"] if n_objects > 1 else []
        return super().notes(obj) + shared


def redraw(context: bpy.types.Context) -> None:
    """Draws the sidebars of all 3D views again, as their progress has changed."""
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()
