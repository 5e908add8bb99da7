"""`minidual replay`: run a dump or recorded trial again and report the first fault."""

from dataclasses import asdict
from pathlib import Path

from minidual.errors import ExitCode, UsageError, check_name
from minidual.gate.stage import ToolContext, ToolResult
from minidual.plant.model import build_model
from minidual.plant.recording import Recording, read_recording
from minidual.plant.replay import Replayed, replay
from minidual.show.figures.film import CAMERAS, FILM_FPS, Postures, film_postures, sheet_of_postures
from minidual.stages.plan_tools import target_file


def replay_tool(context: ToolContext) -> ToolResult:
    """Replay the file; exit 1 if equal versions do not reproduce it, 5 if there was nothing to compare."""
    options = context.options
    camera = options.get("camera", "overview")
    check_name("camera", camera, CAMERAS)
    slowdown = options.get("slowdown", 1.0)
    frames = options.get("frames", 8)
    if not 0.1 <= slowdown <= 100.0:
        raise UsageError(f"--slowdown is {slowdown:g}; 0.1 <= value <= 100")
    if not 1 <= frames <= 48:
        raise UsageError(f"--frames is {frames}; 1 <= value <= 48")
    for option, of in (("slowdown", "video"), ("frames", "picture")):
        if option in options and of not in options:
            raise UsageError(f"--{option} goes with --{of}")
    if "camera" in options and not {"video", "picture"} & options.keys():
        raise UsageError("--camera goes with --video or --picture")
    video = target_file("video", options.get("video"), ".mp4")
    picture = target_file("picture", options.get("picture"), ".png")
    path = Path(options["file"])
    if path.suffix == ".hdf5":
        raise UsageError(
            f"{path} is an episode; a recording of a trial is an .npz",
            remedy="see docs/data.md",
        )
    recording = read_recording(path)
    begin = options.get("from-s", recording.start_s)
    end = options.get("to-s", recording.end_s)
    step_s = (end - begin) / (4 * frames) if video is None else 1.0 / (FILM_FPS * slowdown)
    postures = Postures(max(recording.dt_s, step_s))
    found = replay(
        recording,
        from_s=begin,
        to_s=end,
        on_step=postures if video or picture else None,
    )
    notes: list[str] = []
    if video or picture:
        model = build_model(recording.scene, recording.robot, visuals=True)
        if video is not None:
            notes.append(
                f"film of {film_postures(model, postures.qpos, video, camera=camera)} frames: {video}",
            )
        if picture is not None:
            count = sheet_of_postures(model, postures, picture, frames=frames, camera=camera)
            notes.append(f"sheet of {count} frames: {picture}")
    broken = found.deviates is not None and not found.versions_differ
    code = ExitCode.PASS if found.compared else ExitCode.NOTHING_EVALUATED
    told = {name: getattr(recording, name) for name in ("kind", "reason", "seed", "details")}
    data = {
        "file": str(path),
        **told,
        "made_by": recording.libraries,
        "exact": found.exact,
        **asdict(found),
    }
    return ToolResult(
        _lines(path, recording, found),
        notes,
        data,
        ExitCode.ACCEPTANCE_FAILED if broken else code,
    )


def _lines(path: Path, recording: Recording, found: Replayed) -> list[str]:
    made = ", ".join(f"{name} {version}" for name, version in recording.libraries.items())
    extent = f"{recording.start_s:.3f} s to {recording.end_s:.3f} s"
    seed = "unknown" if recording.seed is None else recording.seed
    lines = [
        f"{path}: {recording.kind}, seed {seed}",
        f"  why       {recording.reason}",
        f"  made by   {made}",
        f"  replayed  {found.from_s:.3f} s to {found.to_s:.3f} s ({found.steps} steps) of {extent}",
        f"  repeats   {_repeats(found)}",
    ]
    if found.versions_differ:
        differ = ", ".join(
            f"{row['name']}: was {row['was']}, is {row['is']}" for row in found.versions_differ
        )
        lines.append(f"  versions  {differ}")
    if found.model_changed:
        lines.append(f"  model     changed from the scene's: {', '.join(found.model_changed)}")
    lines += [f"  first     {sign.text}" for sign in found.first] or [
        "  first     nothing went out of bounds",
    ]
    if recording.kind == "dump":  # the tick of the reflex, which the motors never saw
        lines += [f"  {name}: {_row(values)}" for name, values in recording.details.items()]
    if found.ended is not None:
        lines.append(f"  ended     {found.ended}")
    return lines


def _row(values: object) -> str:
    if not isinstance(values, list):
        return str(values)
    return " ".join(f"{x:.4g}" if isinstance(x, float) else str(x) for x in values)


def _repeats(found: Replayed) -> str:
    off = found.deviates
    n = found.compared
    versions = found.versions_differ
    if off is None:
        return (
            f"to the bit, at {n} of {n} check points"
            if n
            else "nothing compared: no check point in this stretch"
        )
    why = (
        "another version may round differently"
        if versions
        else "the state was changed between two steps"
    )
    size = f"{off.size:.3g}"
    most = f"{found.largest_deviation:.3g}"
    return f"no: {off.what} is off by {size} at {off.time_s:.3f} s, {most} at most; {why}"
