"""The panel in the sidebar of the 3D view, its settings and its buttons."""

from pathlib import Path
from typing import Any

import bpy
import numpy as np

from . import checks, files, jobs

FABRICS = ("cotton", "denim", "jersey", "polyester", "silk", "wool")
HELD = (("top", "Highest border", "The body carries the highest border"), ("none", "Nothing", "It holds by itself"))
TICK_S = 0.5  # from one look at the running command to the next


class GubePreferences(bpy.types.AddonPreferences):
    """Settings of the extension."""

    bl_idname = __package__

    command: bpy.props.StringProperty(
        name="gube command", subtype="FILE_PATH", default="gube", description="The command gube, or its path"
    )

    def draw(self, context: Any) -> None:
        """Draw the settings."""
        self.layout.prop(self, "command")


class GubeSettings(bpy.types.PropertyGroup):
    """Settings of a Blender scene."""

    armature: bpy.props.PointerProperty(
        name="Armature", type=bpy.types.Object, poll=lambda self, item: item.type == "ARMATURE"
    )
    garment: bpy.props.PointerProperty(
        name="Garment", type=bpy.types.Object, poll=lambda self, item: item.type == "MESH"
    )
    fabric: bpy.props.EnumProperty(name="Fabric", items=[(name, name.capitalize(), "") for name in FABRICS])
    attach: bpy.props.EnumProperty(name="Held by", items=HELD)
    folder: bpy.props.StringProperty(name="Folder", subtype="DIR_PATH", default="//gube")
    findings: bpy.props.StringProperty(options={"HIDDEN"})
    status: bpy.props.StringProperty(options={"HIDDEN"})


def find_problems(settings: Any) -> list[checks.Finding]:
    """All checks of the chosen armature and garment."""
    armature, garment = settings.armature, settings.garment
    if armature is None or garment is None:
        return [checks.Finding(False, "Choose an armature and a garment")]
    items = files.bodies(armature, garment)
    if not items:
        return [checks.Finding(False, "No mesh has an Armature modifier with this armature: bind the body to it")]
    with files.rest_pose(armature):
        body, cloth = files.triangles(items), files.triangles([garment])
        inside = files.depths(cloth[0], items)
    data = armature.animation_data
    span = data.action.frame_range if data and data.action else (None, None)
    return [
        *checks.check_body(*body),
        *checks.check_garment(*cloth, np.array(garment.scale)),
        checks.check_fit(inside),
        checks.check_motion(*span, files.frame_rate()),
    ]


def folder_of(settings: Any) -> Path:
    """Where files are written."""
    return Path(bpy.path.abspath(settings.folder))


def command_of(context: Any) -> str:
    """The command gube, as the preferences name it."""
    addon = context.preferences.addons.get(__package__)
    return addon.preferences.command if addon else "gube"


class GubeCheck(bpy.types.Operator):
    """Check body and garment, and say what to do."""

    bl_idname, bl_label = "gube.check", "Check"

    def execute(self, context: Any) -> set[str]:
        """Keep the findings for the panel."""
        settings = context.scene.gube
        found = find_problems(settings)
        settings.findings = "\n".join(("+" if one.passed else "-") + one.text for one in found)
        failed = [one.text for one in found if not one.passed]
        self.report({"WARNING"} if failed else {"INFO"}, failed[0] if failed else "All checks are passed")
        return {"FINISHED"}


class GubeWrite(bpy.types.Operator):
    """Write body, garment and scene file."""

    bl_idname, bl_label = "gube.write", "Write scene file"

    def execute(self, context: Any) -> set[str]:
        """Refuse what cannot be simulated at all; the other findings are the artist's choice."""
        settings = context.scene.gube
        if not bpy.data.filepath and settings.folder.startswith("//"):
            self.report({"ERROR"}, "The file has no folder yet: save it, or choose another folder")
            return {"CANCELLED"}
        found = find_problems(settings)
        if len(found) == 1 or not found[-1].passed:
            self.report({"ERROR"}, found[-1].text)
            return {"CANCELLED"}
        path = files.write_scene(
            folder_of(settings), settings.armature, settings.garment, settings.fabric, settings.attach
        )
        settings.status = f"wrote {path}"
        return {"FINISHED"}


class GubeLearn(bpy.types.Operator):
    """Learn the folds and put the result on the garment; Esc stops, and the next run goes on from there."""

    bl_idname, bl_label = "gube.learn", "Learn and bake"

    def _start(self, context: Any) -> jobs.Job | None:
        scene = folder_of(context.scene.gube) / "scene.toml"
        if bpy.ops.gube.write() != {"FINISHED"}:
            return None
        return jobs.Job(jobs.commands(command_of(context), scene, files.CLIP, files.frame_rate()))

    def _end(self, context: Any, job: jobs.Job) -> set[str]:
        settings = context.scene.gube
        settings.status = job.error or job.line
        if job.error:
            self.report({"ERROR"}, job.error)
            return {"CANCELLED"}
        files.show_result(folder_of(settings), settings.armature, settings.garment)
        return {"FINISHED"}

    def execute(self, context: Any) -> set[str]:
        """Without a window: wait for the end."""
        job = self._start(context)
        if job is None:
            return {"CANCELLED"}
        job.wait()
        return self._end(context, job)

    def invoke(self, context: Any, event: Any) -> set[str]:
        """With a window: look at the command now and then."""
        self._job = self._start(context)
        if self._job is None:
            return {"CANCELLED"}
        self._timer = context.window_manager.event_timer_add(TICK_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        """Show the last line of the command; stop it on Esc."""
        if event.type == "ESC":
            self._job.stop()
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        context.scene.gube.status = self._job.line
        for area in context.screen.areas:
            area.tag_redraw()
        if self._job.running:
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self._timer)
        return self._end(context, self._job)


class GubePanel(bpy.types.Panel):
    """The panel."""

    bl_idname, bl_label = "VIEW3D_PT_gube", "gube"
    bl_space_type, bl_region_type, bl_category = "VIEW_3D", "UI", "gube"

    def draw(self, context: Any) -> None:
        """Draw settings, buttons, findings and the state of the command."""
        settings, layout = context.scene.gube, self.layout
        for name in ("armature", "garment", "fabric", "attach", "folder"):
            layout.prop(settings, name)
        for operator in (GubeCheck, GubeWrite, GubeLearn):
            layout.operator(operator.bl_idname)
        for line in settings.findings.splitlines():
            layout.label(text=line[1:], icon="CHECKMARK" if line[0] == "+" else "ERROR")
        if settings.status:
            layout.label(text=settings.status)


CLASSES = (GubePreferences, GubeSettings, GubeCheck, GubeWrite, GubeLearn, GubePanel)


def register() -> None:
    """Make Blender know the classes."""
    for one in CLASSES:
        bpy.utils.register_class(one)
    bpy.types.Scene.gube = bpy.props.PointerProperty(type=GubeSettings)


def unregister() -> None:
    """Make Blender forget them."""
    del bpy.types.Scene.gube
    for one in reversed(CLASSES):
        bpy.utils.unregister_class(one)
