"""The extension for Blender: a garment on an armature becomes a scene of gube, and the result a mesh cache.

It runs inside Blender, and so imports Blender's own modules, numpy and the standard library alone. The command `gube`
does the work in a process of its own.
"""


def register() -> None:
    """Called by Blender when the extension is switched on."""
    from . import panel

    panel.register()


def unregister() -> None:
    """Called by Blender when the extension is switched off."""
    from . import panel

    panel.unregister()
