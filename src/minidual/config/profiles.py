"""Finding profiles."""

from pathlib import Path

from minidual.durable import expanded, kind_of
from minidual.errors import ConfigError, unknown_name

SHIPPED_FOLDER = Path(__file__).resolve().parent.parent / "configs"
DEFAULT_PROFILE = "standard"


def shipped_profiles() -> tuple[str, ...]:
    """Return the names of the shipped profiles."""
    return tuple(sorted(path.stem for path in SHIPPED_FOLDER.glob("*.yaml")))


def find_profile(profile: str, relative_to: Path | None = None) -> tuple[str, Path]:
    """Return (name, file) of a shipped name or .yaml path.

    Raises:
        UsageError: Unknown name.
        ConfigError: Missing file, or one with a shipped profile's name.
    """
    if not profile.endswith((".yaml", ".yml")):
        if profile not in shipped_profiles():
            error = unknown_name("profile", profile, shipped_profiles())
            error.remedy = error.remedy or "or give the path of a profile file that ends in .yaml"
            raise error
        return profile, SHIPPED_FOLDER / f"{profile}.yaml"
    path = (relative_to or Path.cwd()) / expanded(profile)
    if (kind := kind_of(path)) != "file":
        what, shipped = f": it is a {kind}" if kind else "", ", ".join(shipped_profiles())
        raise ConfigError(f"no profile file {path}{what}", remedy=f"shipped profiles are {shipped}")
    if path.resolve().parent == SHIPPED_FOLDER:
        return path.stem, path.resolve()
    if path.stem in shipped_profiles():
        raise ConfigError(
            f"{path} bears the name of the shipped profile '{path.stem}', its verdicts could not be told apart",
            remedy=f"rename it, and begin it with 'extends: {path.stem}'",
        )
    return path.stem, path
