"""A run as a film: one sheet, moved from frame to frame, written as GIF or MP4 while it is drawn.

Frames are encoded one at a time, so that a long film needs no more memory than a short one.
"""

import importlib
import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

from spherejax.files.paths.drafts import draft_of
from spherejax.foundations.errors import SceneError
from spherejax.output.paths import make_folder, require_free
from spherejax.output.plot.mechanism import Mechanism
from spherejax.output.plot.sheet import Sheet, Wishes
from spherejax.output.plot.space import poses_of
from spherejax.output.search_path import program_on_path

FORMATS = (".gif", ".mp4")
"""What can be written."""

FILM_SECONDS = 6.0
"""Length of a film whose pace is not given, about: long enough to see, short enough to wait for."""

ROUND = (1.0, 2.0, 5.0)
"""Paces are 1, 2 or 5 times a power of ten unless one is given."""

GIF_TICK, FEWEST_TICKS = 0.01, 2
"""A GIF counts the length of a frame in hundredths of a second [s], and viewers slow down frames below two of them."""

MOST_FRAMES = 20_000
"""More frames than this are taken for a mistake in fps or slow: they would fill hours and gigabytes."""

Report = Callable[[str, float], None]


def animation_path(path: str | os.PathLike, *, overwrite: bool) -> Path:
    """The path of a film, with its folder made; an error when it cannot be written.

    Raises:
        SceneError: for another ending, an existing file without `overwrite`, or an MP4 without ffmpeg.
    """
    path = Path(path).expanduser()
    if path.suffix.lower() not in FORMATS:
        raise SceneError(f"{str(path)!r}: the ending {path.suffix!r} names no film; use {' or '.join(FORMATS)}")
    if path.suffix.lower() == ".mp4":
        ffmpeg()
    require_free(path, overwrite=overwrite)
    make_folder(path.parent)
    return path


def ffmpeg() -> str:
    """The ffmpeg program: of the machine, or of the package imageio-ffmpeg.

    Raises:
        SceneError: where there is neither.
    """
    if found := program_on_path("ffmpeg"):
        return found
    try:
        return importlib.import_module("imageio_ffmpeg").get_ffmpeg_exe()
    except (ImportError, RuntimeError) as error:
        raise SceneError(
            "an MP4 needs ffmpeg, which is not installed: pip install 'spherejax[video]', or write a GIF (.gif)"
        ) from error


def frame_times(mechanism: Mechanism, seconds: float, slow: float) -> np.ndarray:
    """Times of the frames [s]: equal steps from the first sample, up to the last.

    Args:
        mechanism: the motion.
        seconds: how long a frame is shown [s].
        slow: seconds of the film for a second of the motion.

    Raises:
        SceneError: for more frames than anyone would watch.
    """
    first, last = float(mechanism.ts[0]), float(mechanism.ts[-1])
    step = seconds / slow
    n_frames = int(np.floor((last - first) / step * (1 + 1e-12))) + 1
    if n_frames > MOST_FRAMES:
        raise SceneError(
            f"{n_frames:,} frames are too many (at most {MOST_FRAMES:,}): take a smaller slow= (it is {slow:g}) or fps="
        )
    return np.minimum(first + step * np.arange(n_frames), last)


def usual_pace(duration: float) -> float:
    """A round number of seconds of film for a second of motion, with which the film lasts about `FILM_SECONDS`."""
    wanted = FILM_SECONDS / duration
    choices = [one * 10.0**power for power in range(-9, 13) for one in ROUND]
    return min(choices, key=lambda one: abs(np.log(one / wanted)))


def pace_in_words(slow: float) -> str:
    """How the film runs against the motion."""
    if slow == 1.0:
        return "real time"
    return f"slowed down {slow:g} times" if slow > 1 else f"speeded up {1 / slow:g} times"


def write_animation(
    mechanism: Mechanism,
    path: Path,
    wishes: Wishes,
    *,
    fps: float,
    slow: float | None,
    dpi: float,
    report: Report | None,
    pace: str | None = None,
) -> Path:
    """Draw and write all frames; `spherejax.animate` explains the arguments, `pace` what `Sheet` writes of it."""
    for name, value in (("fps", fps), ("slow", slow), ("dpi", dpi)):
        if value is not None and not 0 < value < np.inf:
            raise SceneError(f"{name} = {value:g} must be positive and finite")
    if len(mechanism.ts) < 2:
        raise SceneError("one sample is no motion; simulate with at least two sample times, or draw a picture")
    slow = usual_pace(float(mechanism.ts[-1] - mechanism.ts[0])) if slow is None else float(slow)
    is_gif = path.suffix.lower() == ".gif"
    seconds = GIF_TICK * max(FEWEST_TICKS, round(1 / (fps * GIF_TICK))) if is_gif else 1 / fps
    times = frame_times(mechanism, seconds, slow)
    pace = pace_in_words(slow) if pace is None else pace
    sheet = Sheet(mechanism, poses_of(mechanism), wishes, pace=pace, dpi=dpi)
    few = times[np.linspace(0, len(times) - 1, PALETTE_FRAMES).astype(int)]
    palette = Palette(list(drawn_frames(sheet, few, None))) if is_gif else None
    frames = drawn_frames(sheet, times, report)
    try:
        with draft_of(path) as draft:
            if palette is not None:
                _write_gif(frames, palette, draft, seconds)
            else:
                _write_mp4(frames, draft, seconds, path)
    except OSError as error:
        raise SceneError(f"cannot write {str(path)!r}: {error.strerror or error}") from error
    return path


def drawn_frames(sheet: Sheet, times: np.ndarray, report: Report | None) -> Iterator[np.ndarray]:
    """Pictures of a sheet, red, green and blue, shape (height, width, 3); a new array each."""
    canvas = sheet.figure.canvas
    assert isinstance(canvas, FigureCanvasAgg)
    moving = sheet.moving_artists
    for artist in moving:
        artist.set_animated(True)  # left out when the figure is drawn: what rests is drawn once
    canvas.draw()
    resting = canvas.copy_from_bbox(sheet.figure.bbox)
    for done, t in enumerate(times, start=1):
        canvas.restore_region(resting)
        sheet.update(sheet.mechanism.pose(float(t)))
        for artist in sorted(moving, key=lambda one: one.get_zorder()):
            sheet.figure.draw_artist(artist)
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()
        if report is not None:
            report(f"frame {done} of {len(times)}", done / len(times))


class Palette:
    """The most frequent colors of a few frames, one for each cell of colors that no eye tells apart.

    A drawing has few colors, and they must be exact, above all its white: Pillow's own tables are coarser.
    """

    def __init__(self, frames: list[np.ndarray]):
        pixels = np.concatenate([frame.reshape(-1, 3) for frame in frames])
        codes, counts = np.unique(pixels.astype(np.uint32) @ _CODE, return_counts=True)
        frequent = codes[np.argsort(-counts)]
        colors = np.stack([frequent >> 16, frequent >> 8 & 255, frequent & 255], -1).astype(np.uint8)
        _, first = np.unique(_cells(colors), return_index=True)
        chosen = np.sort(first)[:N_COLORS]
        self.colors = colors[chosen]
        self.index_of_cell = np.full(64**3, -1, np.int16)
        self.index_of_cell[_cells(self.colors)] = np.arange(len(chosen))

    def image(self, frame: np.ndarray) -> Image.Image:
        """A frame in the colors of the palette, each pixel in the nearest."""
        cells = _cells(frame)
        unknown = np.unique(cells[self.index_of_cell[cells] < 0])
        if unknown.size:
            middle = 4 * np.stack([unknown >> 12, unknown >> 6 & 63, unknown & 63], -1)[:, None, :] + 2
            distances = np.sum((middle - self.colors[None].astype(int)) ** 2, axis=-1)
            self.index_of_cell[unknown] = np.argmin(distances, axis=1)
        image = Image.frombytes("P", frame.shape[1::-1], self.index_of_cell[cells].astype(np.uint8).tobytes())
        image.putpalette(self.colors.tobytes())
        return image


N_COLORS, PALETTE_FRAMES = 255, 5
"""Colors of a GIF (one less than it has room for), and frames from which they are taken."""

_CODE = np.array([65536, 256, 1], np.uint32)


def _cells(colors: np.ndarray) -> np.ndarray:
    """The six leading bits of red, green and blue as one number."""
    leading = colors.astype(np.int32) >> 2
    return leading[..., 0] << 12 | leading[..., 1] << 6 | leading[..., 2]


def _write_gif(frames: Iterator[np.ndarray], palette: Palette, path: Path, seconds: float) -> None:
    """One palette for all frames, so that what rests costs nothing."""
    images = (palette.image(frame) for frame in frames)
    first = next(images)
    first.save(path, save_all=True, append_images=images, duration=round(1000 * seconds), loop=0, optimize=False)


def _write_mp4(frames: Iterator[np.ndarray], path: Path, seconds: float, shown: Path) -> None:
    """Raw frames through a pipe into ffmpeg; an error names the path that is shown."""
    first = _even(next(frames))
    height, width = first.shape[:2]
    command = [
        ffmpeg(), "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}",
        "-framerate", f"{1 / seconds:.9g}", "-i", "-", "-an", "-vcodec", "libx264", "-crf", "18",
        "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(path),
    ]  # fmt: skip
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stderr is not None
        try:
            process.stdin.write(first.tobytes())
            for frame in frames:
                process.stdin.write(_even(frame).tobytes())
            process.stdin.close()
        except BrokenPipeError:
            pass  # ffmpeg has stopped; what it says follows
        words = " ".join(process.stderr.read().decode(errors="replace").split())
    if process.returncode:
        raise SceneError(f"ffmpeg cannot write {str(shown)!r}: {words[-300:]}; or write a GIF (.gif)")


def _even(frame: np.ndarray) -> np.ndarray:
    """The frame with even numbers of rows and columns, which the codec asks for."""
    return np.ascontiguousarray(frame[: frame.shape[0] // 2 * 2, : frame.shape[1] // 2 * 2])
