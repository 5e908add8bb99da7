"""`minidual replay`: run a dump or recorded trial again and report the first fault."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from minidual.errors import ExitCode, UsageError, check_name
from minidual.gate.stage import ToolContext, ToolResult
from minidual.plant.recording import Recording, read_recording
from minidual.plant.replay import Replayed, replay
from minidual.show.figures.film import CAMERAS, FILM_FPS, Postures, film_postures, sheet_of_postures
from minidual.show.figures.film_model import film_model
from minidual.stages.output_file import target_file


@dataclass(frozen=True)
class _Pictures:
    """Curves to draw of a replay.

    Attributes:
        video: File of the film, or None.
        picture: File of the sheet of frames, or None.
        camera: Row of CAMERAS.
        slowdown: How many times slower than life the film is.
        frames: Frames on the sheet.
    """

    video: Path | None
    picture: Path | None
    camera: str
    slowdown: float
    frames: int

    @property
    def wanted(self) -> bool:
        """Whether anything is drawn."""
        return self.video is not None or self.picture is not None

    def period_s(self, duration_s: float) -> float:
        """Return the time between two postures [s]."""
        if self.video is not None:
            return 1.0 / (FILM_FPS * self.slowdown)
        return duration_s / (4 * self.frames)

    def draw(self, recording: Recording, postures: Postures) -> list[str]:
        """Write the files; return a note for each."""
        if not self.wanted:
            return []
        notes: list[str] = []
        model = film_model(recording.scene, recording.robot)
        if self.video is not None:
            count = film_postures(model, postures.qpos, self.video, camera=self.camera)
            notes.append(f"film of {count} frames: {self.video}")
        if self.picture is not None:
            count = sheet_of_postures(
                model,
                postures,
                self.picture,
                frames=self.frames,
                camera=self.camera,
            )
            notes.append(f"sheet of {count} frames: {self.picture}")
        return notes


def replay_tool(context: ToolContext) -> ToolResult:
    """Replay the file.

    Exit 1 if equal versions do not reproduce it, 5 if there was nothing to compare.
    """
    options = context.options
    pictures = _pictures(options)
    path = Path(options["file"])
    if path.suffix == ".hdf5":
        raise UsageError(
            f"{path} is an episode; a recording of a trial is an .npz",
            remedy="see docs/data.md",
        )
    recording = read_recording(path)
    from_s = options.get("from-s", recording.start_s)
    to_s = options.get("to-s", recording.end_s)
    postures = Postures(max(recording.dt_s, pictures.period_s(to_s - from_s)))
    replayed = replay(
        recording,
        from_s=from_s,
        to_s=to_s,
        on_step=postures if pictures.wanted else None,
    )
    notes = pictures.draw(recording, postures)
    data = {
        "file": str(path),
        "kind": recording.kind,
        "reason": recording.reason,
        "seed": recording.seed,
        "details": recording.details,
        "made_by": recording.libraries,
        "exact": replayed.exact,
        **asdict(replayed),
    }
    return ToolResult(_lines(path, recording, replayed), notes, data, _exit_code(replayed))


def _pictures(options: Mapping[str, Any]) -> _Pictures:
    """Return the request of the options.

    Raises:
        UsageError: A value is out of bounds, a file cannot be written, or an option needs another.
    """
    camera = options.get("camera", "overview")
    check_name("camera", camera, CAMERAS)
    slowdown = options.get("slowdown", 1.0)
    if not 0.1 <= slowdown <= 100.0:
        raise UsageError(f"--slowdown is {slowdown:g}; 0.1 <= value <= 100")
    frames = options.get("frames", 8)
    if not 1 <= frames <= 48:
        raise UsageError(f"--frames is {frames}; 1 <= value <= 48")
    for option, needed in (("slowdown", "video"), ("frames", "picture")):
        if option in options and needed not in options:
            raise UsageError(f"--{option} goes with --{needed}")
    if "camera" in options and not {"video", "picture"} & options.keys():
        raise UsageError("--camera goes with --video or --picture")
    return _Pictures(
        video=target_file("video", options.get("video"), ".mp4"),
        picture=target_file("picture", options.get("picture"), ".png"),
        camera=camera,
        slowdown=slowdown,
        frames=frames,
    )


def _exit_code(replayed: Replayed) -> ExitCode:
    if replayed.deviates is not None and not replayed.versions_differ:
        return ExitCode.ACCEPTANCE_FAILED
    return ExitCode.PASS if replayed.compared else ExitCode.NOTHING_EVALUATED


def _lines(path: Path, recording: Recording, replayed: Replayed) -> list[str]:
    libraries = ", ".join(f"{name} {version}" for name, version in recording.libraries.items())
    extent = f"{recording.start_s:.3f} s to {recording.end_s:.3f} s"
    stretch = f"{replayed.from_s:.3f} s to {replayed.to_s:.3f} s ({replayed.steps} steps)"
    seed = "unknown" if recording.seed is None else recording.seed
    lines = [
        f"{path}: {recording.kind}, seed {seed}",
        f"  why       {recording.reason}",
        f"  made by   {libraries}",
        f"  replayed  {stretch} of {extent}",
        f"  repeats   {_repeats(replayed)}",
    ]
    if replayed.versions_differ:
        differences = ", ".join(
            f"{row['name']}: was {row['was']}, is {row['is']}" for row in replayed.versions_differ
        )
        lines.append(f"  versions  {differences}")
    if replayed.model_changed:
        lines.append(f"  model     changed from the scene's: {', '.join(replayed.model_changed)}")
    if replayed.first:
        lines += [f"  first     {sign.text}" for sign in replayed.first]
    else:
        lines.append("  first     nothing went out of bounds")
    if recording.kind == "dump":  # the tick of the reflex, which the motors never saw
        lines += [f"  {name}: {_row(values)}" for name, values in recording.details.items()]
    if replayed.ended is not None:
        lines.append(f"  ended     {replayed.ended}")
    return lines


def _row(values: object) -> str:
    if not isinstance(values, list):
        return str(values)
    return " ".join(f"{x:.4g}" if isinstance(x, float) else str(x) for x in values)


def _repeats(replayed: Replayed) -> str:
    deviation = replayed.deviates
    if deviation is None:
        n = replayed.compared
        if n == 0:
            return "nothing compared: no check point in this stretch"
        return f"to the bit, at {n} of {n} check points"
    if replayed.versions_differ:
        cause = "another version may round differently"
    else:
        cause = "the state was changed between two steps"
    return (
        f"no: {deviation.what} is off by {deviation.size:.3g} at {deviation.time_s:.3f} s, "
        f"{replayed.largest_deviation:.3g} at most; {cause}"
    )
