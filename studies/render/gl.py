"""The available OpenGL, found by a trial in a separate process, because a broken driver can end the process.

MuJoCo's contexts are used directly. The variable MUJOCO_GL has no later effect, because mujoco reads it on import. This file
has no heavy imports.
"""

import functools
import importlib
import os
import subprocess
import sys
from dataclasses import dataclass

from linkplan.models.errors import LinkplanError, one_line

# In the order of trials: contexts without a window first.
_BY_SYSTEM = {"linux": ("egl", "osmesa", "glfw"), "darwin": ("cgl", "glfw")}
_OFF = ("disable", "disabled", "off", "false", "0")
_ANY = ("", "enable", "enabled", "on", "true", "1")
_MODULES = {"glx": "glfw", "wgl": "glfw"}
_TRY = """
import importlib, sys
if sys.argv[1] == "glfw":
    import glfw, warnings
    warnings.simplefilter("ignore")
    assert glfw.init(), "no window system answers"
context = importlib.import_module("mujoco." + sys.argv[1]).GLContext(16, 16)
context.make_current()
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco/>")
drawn = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, drawn)
assert drawn.currentBuffer == mujoco.mjtFramebuffer.mjFB_OFFSCREEN, "it draws to no picture"
print("DRAWS")
import os
sys.stdout.flush()
os._exit(0)
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class GL:
    """The name of MuJoCo's module for the OpenGL; None with the reason if there is none."""

    name: str | None
    why_not: str = ""


def find_gl(asked: str | None) -> GL:
    """Return the first OpenGL that draws a picture.

    Args:
        asked: the value of MUJOCO_GL: a name, "disable", or "enable" for any; None if it is not set.

    Raises:
        LinkplanError: if MUJOCO_GL has an unknown value.
    """
    word = (asked or "").lower().strip()
    if word in _OFF:
        return GL(name=None, why_not=f"MUJOCO_GL is {word}")
    known = _BY_SYSTEM.get(sys.platform, ("glfw",))
    if word not in (*_ANY, *known, *_MODULES):
        raise LinkplanError(f"MUJOCO_GL must be {', '.join(known)} or disable, got '{word}'")
    names = known if word in _ANY else (_MODULES.get(word, word),)
    loaded = os.environ.get("PYOPENGL_PLATFORM", "") if "OpenGL" in sys.modules else ""
    if loaded in names:
        names = (loaded,)  # a process can use one platform only
    from linkplan.controllers.playback import has_screen

    said = []
    for name in names:
        if name == "glfw" and not has_screen():
            said.append("glfw: no display")
            continue
        why_not = _tried(name, os.environ.get("DISPLAY", ""))
        if not why_not:
            return GL(name=name)
        said.append(f"{name}: {why_not}")
    return GL(name=None, why_not="; ".join(said))


@functools.lru_cache(maxsize=16)
def _tried(name: str, display: str) -> str:
    """Return the reason why an OpenGL cannot be used, "" if it can. `display` is a key of the cache."""
    del display
    environment = {key: value for key, value in os.environ.items() if key != "PYOPENGL_PLATFORM"} | {"MUJOCO_GL": "disable"}
    try:
        done = subprocess.run(
            [sys.executable, "-c", _TRY, name],
            env=environment,
            capture_output=True,
            stdin=subprocess.DEVNULL,
            timeout=30.0,  # a trial takes half a second, unless the driver hangs
            text=True,
            errors="replace",
        )
    except (OSError, subprocess.SubprocessError) as error:
        return one_line(error)[:120]
    if "DRAWS" in done.stdout:
        return ""
    last = [line for line in done.stderr.splitlines() if line.strip()][-1:] or [f"ended by {done.returncode}"]
    return one_line(last[0])[:120]


def context_class(name: str) -> type:
    """Return MuJoCo's context class for an OpenGL."""
    return importlib.import_module(f"mujoco.{name}").GLContext
