"""A plan's tracked motion as an MP4, a GIF or a PNG (`linkplan render`)."""

import base64
import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from html import escape
from pathlib import Path

import mujoco
import numpy as np
from msgspec import Struct

from linkplan.models.deadline import check
from linkplan.models.errors import ProblemError, nearest
from linkplan.models.mechanism import Mechanism
from linkplan.planner.files.single_file import write_file_whole
from linkplan.planner.search.planning import silent
from linkplan.studies.output.document import Block, Text
from linkplan.studies.output.result import Shown
from linkplan.studies.render.caption import INK, effort_lines, frame_lines, head_share, written
from linkplan.studies.render.film_file import write_gif, write_mp4, write_png
from linkplan.studies.render.framing import FOOT_MARGIN, SIDE_MARGIN, axes_of, framed, own_direction
from linkplan.studies.render.gl import GL
from linkplan.studies.render.motion import TrackedMotion, frame_times, own_slowness
from linkplan.studies.render.scenes import Scene, all_points, coloured_model, film_scenes, place_bodies, stroboscopic_scene
from linkplan.studies.render.settings import SUFFIXES, RenderSettings
from linkplan.studies.render.shapes import GHOST

# Largest file that a notebook embeds, in which it becomes a third larger.
_LARGEST_SHOWN_BYTES = 30_000_000

Paint = Callable[[Scene], np.ndarray]


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """A direction of sight, azimuth and elevation [rad], and the index of the model's camera; -1 for a free camera."""

    direction: tuple[float, float]
    fixed: int = -1


def camera_from(text: str | None, mechanism: Mechanism) -> Camera:
    """Return the camera for None (the default), a name, or "azimuth/elevation" in degrees.

    Raises:
        ProblemError: for any other text.
    """
    model = mechanism.model
    if text is None:
        return Camera(direction=own_direction(model))
    names = [model.camera(k).name for k in range(model.ncam)]
    if text in names:
        data = mujoco.MjData(model)
        place_bodies(model, data, mechanism.qpos_of(mechanism.home))
        sight = -np.array(data.cam_xmat[names.index(text)]).reshape(3, 3)[:, 2]
        direction = float(np.arctan2(sight[1], sight[0])), float(np.arcsin(np.clip(sight[2], -1.0, 1.0)))
        return Camera(direction=direction, fixed=names.index(text))
    parts = text.split("/")
    try:
        azimuth, elevation = (float(part) for part in parts)
    except ValueError:
        known = [name for name in names if name]
        has = f"its cameras are {', '.join(known)}" if known else "it has no named camera"
        raise ProblemError(
            f"unknown camera '{text}'{nearest(text, known)} of '{mechanism.name}': {has}; or AZIMUTH/ELEVATION in degrees,"
            " as 90/-15"
        ) from None
    if not (np.isfinite(azimuth) and abs(elevation) <= 90):
        raise ProblemError(f"a camera's elevation must be from -90 to 90 degrees, its azimuth any number, got '{text}'")
    return Camera(direction=(float(np.radians(azimuth)), float(np.radians(elevation))))


class RenderedFile(Shown, Struct, frozen=True, kw_only=True):
    """The written file: its frames and their size, its frames per second, its slow-motion factor and its renderer."""

    file: str
    frames: int
    size: tuple[int, int]
    fps: float | None
    slow: float | None
    length_s: float | None  # of the film
    motion_s: float
    drawn_by: str
    tracker: str
    stable: bool
    plan: str  # its problem's name
    passed: bool  # the plan passes its certificate

    @property
    def sentence(self) -> str:
        """A sentence on the written file."""
        width, height = self.size
        text = f"{self.file}: {width}x{height}, drawn by {self.drawn_by}"
        if self.length_s is not None:
            text = (
                f"{self.file}: {self.frames} frames of {width}x{height}, {self.length_s:.3g} s at {self.fps:g} frames/s:"
                f" {self.motion_s:.4g} s of motion, {self.slow:g} times slower, drawn by {self.drawn_by}"
            )
        return text if self.stable else f"{text}; the run with {self.tracker} is unstable"

    def blocks(self) -> list[Block]:
        """Return what was written as a document's blocks."""
        return [Text(text=self.sentence)]

    def __repr__(self) -> str:
        return f"RenderedFile('{self.file}')"

    def _repr_html_(self) -> str | None:
        """Return the film or picture as HTML; None if it was moved or is too large for a notebook to keep."""
        path = Path(self.file)
        if not path.is_file() or path.stat().st_size > _LARGEST_SHOWN_BYTES:
            return None
        data = base64.b64encode(path.read_bytes()).decode("ascii")
        if path.suffix == ".mp4":
            return f'<video controls loop src="data:video/mp4;base64,{data}"></video>'
        return f'<img alt="{escape(self.sentence)}" src="data:image/{path.suffix[1:]};base64,{data}">'


def render(
    motion: TrackedMotion, path: Path, settings: RenderSettings, gl: GL, say: Callable[[str], None] = silent
) -> RenderedFile:
    """Draw a tracked motion into a file, which is written completely or not at all.

    Args:
        motion: what is drawn.
        path: of the file.
        settings: of the film or picture.
        gl: the OpenGL; without one, Matplotlib draws in a plane.
        say: called with lines on the progress.
    """
    camera = camera_from(settings.camera, motion.mechanism)
    slow = own_slowness(motion.duration_s) if settings.slow is None else settings.slow
    times = frame_times(motion.duration_s, slow, settings.fps, repeats=motion.repeats)  # raises before anything is drawn
    if gl.name is None:
        say(f"no OpenGL is available ({gl.why_not}): Matplotlib draws in two dimensions")
    if settings.suffix != ".png":
        say(f"tracked by {settings.tracker}; {motion.duration_s:.4g} s of motion, shown {slow:g} times slower")
    with _painter(motion, camera, settings, gl) as paint:
        if settings.suffix == ".png":
            write_file_whole(path, lambda place: write_png(place, picture(motion, camera, settings, paint)), SUFFIXES)
            n, film = 1, False
        else:
            instants = np.array([motion.index_at(time) for time in times])
            if settings.there_and_back:
                instants = np.concatenate([instants, instants[-2:0:-1]])
            _write_film(path, motion, instants, camera, settings, slow, paint, say)
            n, film = len(instants), True
    return RenderedFile(
        file=str(path),
        frames=n,
        size=settings.size,
        fps=settings.fps if film else None,
        slow=slow if film else None,
        length_s=n / settings.fps if film else None,
        motion_s=motion.duration_s,
        drawn_by="Matplotlib" if gl.name is None else f"MuJoCo ({gl.name})",
        tracker=motion.tracker,
        stable=motion.stable,
        plan=motion.name,
        passed=motion.passed,
    )


@contextlib.contextmanager
def _painter(motion: TrackedMotion, camera: Camera, settings: RenderSettings, gl: GL) -> Iterator[Paint]:
    model, size, points = motion.mechanism.model, settings.size, all_points(motion, camera.direction)
    head = head_share(motion, size)
    if gl.name is None:
        yield flat_painter(points, camera.direction, size, head, motion.mechanism)
        return
    from linkplan.studies.render.mujoco_painter import mujoco_painter

    eye = camera.fixed
    if eye < 0:
        fovy = float(np.radians(model.vis.global_.fovy))
        eye = framed(points, *camera.direction, fovy, size[0] / size[1], head)
    with mujoco_painter(coloured_model(motion.mechanism), gl.name, size, eye, points) as painter:
        yield painter.paint


def flat_painter(
    points: np.ndarray, direction: tuple[float, float], size: tuple[int, int], head: float, mechanism: Mechanism
) -> Paint:
    """Return Matplotlib's painter, which draws as figures do and sees all points (n, 3) [m] without perspective.

    Args:
        points: all visible points at all instants.
        direction: azimuth and elevation [rad].
        size: of the pictures, width and height [px].
        head: the free share of the picture's height at the top.
        mechanism: what is drawn.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import to_hex
    from matplotlib.figure import Figure

    from linkplan.studies.output.draw_bodies import draw_bodies

    right, up, _ = axes_of(*direction)
    plane, dots_per_inch = np.stack([right, up], axis=1), 100.0
    low, high = (points @ plane).min(axis=0), (points @ plane).max(axis=0)
    extent = np.maximum(high - low, 1e-6 * max(1e-6, float((high - low).max())))
    scale = float(np.min(np.array([1 - 2 * SIDE_MARGIN, 1 - head - FOOT_MARGIN]) * size / extent))  # [px/m]
    middle = 0.5 * (low + high) + np.array([0.0, 0.5 * (head - FOOT_MARGIN) * size[1] / scale])
    first, last = middle - np.array(size) / (2 * scale), middle + np.array(size) / (2 * scale)

    def paint(scene: Scene) -> np.ndarray:
        inches = (size[0] / dots_per_inch, size[1] / dots_per_inch)
        canvas = FigureCanvasAgg(Figure(figsize=inches, dpi=dots_per_inch, facecolor="white"))
        axes = canvas.figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_axis_off()
        poses = np.array([mechanism.q_of(figure.qpos) for figure in scene.figures])
        alphas = np.array([GHOST[3] if figure.ghost else figure.alpha for figure in scene.figures])
        looks = [to_hex(GHOST[:3]) if figure.ghost else "" for figure in scene.figures]
        draw_bodies(axes, mechanism, poses, alphas, named=False, plane=(right, up), looks=looks)
        for rod in scene.efforts:
            x, y = (np.array([rod.start, rod.end]) @ plane).T
            width = max(1.0, 2 * rod.radius * scale) * 72.0 / dots_per_inch
            axes.plot(x, y, color=rod.rgba, linewidth=width, solid_capstyle="round", zorder=4)
        axes.set(xlim=(first[0], last[0]), ylim=(first[1], last[1]))
        canvas.draw()
        return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[: size[1], : size[0], :3])

    return paint


def picture(motion: TrackedMotion, camera: Camera, settings: RenderSettings, paint: Paint) -> np.ndarray:
    """Return one image: an instant with the plan's ghost, or several instants of the run, the last one opaque.

    Raises:
        ProblemError: if the instant is after the end of the run.
    """
    if settings.at_s is not None:
        end = float(motion.time_s[-1])
        if settings.at_s > end + float(motion.time_s[-1] - motion.time_s[-2]):
            raise ProblemError(f"the run ends at {end:.4g} s; a picture at {settings.at_s:g} s is not possible")
        k = motion.index_at(settings.at_s)
        image = paint(film_scenes(motion, np.array([k]), camera.direction)[0])
        return written(image, frame_lines(motion, k, 1.0), _foot(motion, ghost=True))
    shown = np.linspace(0.0, motion.time_s[-1], settings.instants if settings.instants > 1 else 2)[-settings.instants :]
    instants = np.array([motion.index_at(time) for time in shown])
    image = paint(stroboscopic_scene(motion, instants, camera.direction))
    said = f"{settings.instants} instants from 0 to {motion.time_s[-1]:.3g} s; efforts at the last"
    return written(image, [(said, INK), *effort_lines(motion, int(instants[-1]))], _foot(motion, ghost=False))


def _write_film(
    path: Path, motion: TrackedMotion, instants, camera: Camera, settings: RenderSettings, slow, paint, say
) -> None:
    n, foot, chunk_size = len(instants), _foot(motion, ghost=True), 50

    def images(chosen: np.ndarray) -> Iterator[np.ndarray]:
        """Yield the images of some control instants, one at a time."""
        for begin in range(0, len(chosen), chunk_size):
            chunk = chosen[begin : begin + chunk_size]
            for k, scene in zip(chunk, film_scenes(motion, chunk, camera.direction), strict=True):
                check()
                yield written(paint(scene), frame_lines(motion, int(k), slow), foot)

    def reported() -> Iterator[np.ndarray]:
        for done, image in enumerate(images(instants), start=1):
            yield image
            if done % 25 == 0:
                say(f"{done} of {n} frames")

    def write(place: Path) -> None:
        """Write the film in its work folder."""
        if settings.suffix == ".mp4":
            write_mp4(place, reported(), settings.fps)
            return
        shown = np.unique(instants)
        some = shown[np.linspace(0, len(shown) - 1, min(len(shown), 7)).astype(int)]
        loads = np.abs(motion.shares[shown]).max(axis=1, initial=0.0)
        some = np.append(some, shown[np.argmax(loads)])  # frames that also contain the red of an effort at its limit
        write_gif(place, reported(), n, settings.fps, list(images(some)))

    write_file_whole(path, write, SUFFIXES)


def _foot(motion: TrackedMotion, *, ghost: bool) -> str:
    return (
        f"{motion.name}, tracked by {motion.tracker}"
        + ("" if motion.stable else ", which is unstable")
        + ("; violet: the plan" if ghost else "")
    )
