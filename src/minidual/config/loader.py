"""Find profiles, load and validate configurations."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import yaml

from minidual.config.document import Document, parse_value, read_document
from minidual.config.methods import settings_model
from minidual.config.root import Config
from minidual.config.validation import keys_at, validate_document, validate_section
from minidual.durable import expanded, kind_of
from minidual.errors import ConfigError, UsageError, unknown_name

SHIPPED_FOLDER = Path(__file__).resolve().parent.parent / "configs"
DEFAULT_PROFILE = "standard"


class Override(NamedTuple):
    """A command-line value; `text` is what was typed."""

    path: str
    value: Any
    text: str


def parse_override(text: str) -> Override:
    """Parse "a.b=value" of --set; ConfigError if malformed."""
    path, equals, value = text.partition("=")
    path = path.strip()
    if not equals or not all(path.split(".")) or not path.isprintable():
        raise ConfigError(
            f"--set {text}: not of the form section.key=value",
            remedy="--set plan.queries_n=30",
        )
    return Override(path, parse_value(value, f"--set {text}", path), f"--set {text}")


class LoadedConfig(NamedTuple):
    """A validated configuration with its origins."""

    config: Config
    profile: str
    sources: tuple[Path, ...]
    overrides: tuple[Override, ...]
    document: Document

    def with_overrides(self, overrides: Sequence[Override]) -> LoadedConfig:
        """Return a validated copy with values replaced."""
        if not overrides:
            return self
        document = copy.deepcopy(self.document)
        resolved = self.config.model_dump(mode="json")
        for override in overrides:
            _apply(document, override, resolved)
        config = _validated(document)
        return LoadedConfig(
            config,
            self.profile,
            self.sources,
            (*self.overrides, *overrides),
            document,
        )

    @property
    def shipped(self) -> str | None:
        """Name of the shipped profile that this one is or extends."""
        for path in reversed(self.sources):
            if path.parent == SHIPPED_FOLDER:
                return path.stem
        return None

    def reference(self) -> Config:
        """Return the shipped profile that this one is held to."""
        return load_config(self.shipped or DEFAULT_PROFILE).config

    def to_yaml(self) -> str:
        """Return resolved YAML, valid for --profile."""
        comments = [f"profile: {self.profile}", *(item.text for item in self.overrides)]
        head = "".join(f"# {comment}\n" for comment in comments)
        values = self.config.model_dump(mode="json")
        return head + yaml.safe_dump(values, sort_keys=False, allow_unicode=True)


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
    kind = kind_of(path)
    if kind != "file":
        detail = f": it is a {kind}" if kind else ""
        shipped = ", ".join(shipped_profiles())
        raise ConfigError(
            f"no profile file {path}{detail}",
            remedy=f"shipped profiles are {shipped}",
        )
    if path.resolve().parent == SHIPPED_FOLDER:
        return path.stem, path.resolve()
    if path.stem in shipped_profiles():
        raise ConfigError(
            f"{path} bears the name of the shipped profile '{path.stem}', "
            "its verdicts could not be told apart",
            remedy=f"rename it, and begin it with 'extends: {path.stem}'",
        )
    return path.stem, path


def load_config(
    profile: str = DEFAULT_PROFILE,
    overrides: Sequence[Override | str] = (),
) -> LoadedConfig:
    """Load a profile (shipped name or .yaml file), apply overrides, and validate.

    Raises:
        ConfigError: All problems.
        UsageError: There is no such profile.
    """
    name, path = find_profile(profile)
    document, sources = _read_chain(path, ())
    document.source = path.name
    loaded = LoadedConfig(_validated(document), name, sources, (), document)
    return loaded.with_overrides(
        [parse_override(item) if isinstance(item, str) else item for item in overrides],
    )


def _validated(document: Document) -> Config:
    """Return the configuration; sections of plug-in methods are checked with their own models.

    Raises:
        ConfigError: All problems.
    """
    config = validate_document(document, Config)
    for name in config.methods.others:
        section = ("methods", name)
        try:
            model = settings_model(name)
        except UsageError as error:
            where = document.origins.get(".".join(section), document.source)
            raise ConfigError(f"{where}: {error.message}", remedy=error.remedy) from error
        validate_section(document, section, model)
    return config


def _read_chain(path: Path, below: tuple[Path, ...]) -> tuple[Document, tuple[Path, ...]]:
    """Return a profile merged over those that it extends, and their files.

    Args:
        path: The profile.
        below: Profiles that extend it, resolved.
    """
    if path.resolve() in below:
        chain = " -> ".join(item.name for item in (*below, path))
        raise ConfigError(f"{path.name}: profiles extend each other in a circle: {chain}")
    document = read_document(path)
    if not document.tree:
        raise ConfigError(
            f"{path.name} is empty",
            remedy="begin it with 'extends: standard', then what differs",
        )
    base_name = document.tree.pop("extends", None)
    if base_name is None:
        return document, (path,)
    where = document.origins.pop("extends")
    if not isinstance(base_name, str):
        raise ConfigError(f"{where}: extends: must be one profile's name or file, is {base_name!r}")
    try:
        _, base_path = find_profile(base_name, path.parent)
    except UsageError as error:
        raise ConfigError(f"{where}: extends: {error.message}", remedy=error.remedy) from error
    base, sources = _read_chain(base_path, (*below, path.resolve()))
    _refuse_regained_acceptance(base.tree, document.tree, where)
    _merge(base.tree, document.tree, ())
    base.origins.update(document.origins)
    return base, (*sources, path)


def _merge(base: dict[str, Any], over: Mapping[str, Any], location: tuple[str, ...]) -> None:
    """Merge `over` into `base` by section; replace other mappings."""
    for key, value in over.items():
        inner = (*location, key)
        if isinstance(value, dict) and isinstance(base.get(key), dict) and keys_at(inner):
            _merge(base[key], cast(dict[str, Any], value), inner)
        else:
            base[key] = value


def _refuse_regained_acceptance(
    base: Mapping[str, Any],
    over: Mapping[str, Any],
    where: str,
) -> None:
    if base.get("acceptance") is False and over.get("acceptance", False) is not False:
        raise ConfigError(
            f"{where}: acceptance: a profile that does not count as acceptance cannot be made to",
            remedy="extend 'standard' instead",
        )


def _apply(document: Document, override: Override, resolved: dict[str, Any]) -> None:
    """Set one value; other keys of a mapping stay.

    Args:
        document: Changed in place.
        override: The value.
        resolved: All values under the document, with defaults.
    """
    if override.path == "acceptance":
        _refuse_regained_acceptance(document.tree, {"acceptance": override.value}, override.text)
    *sections, key = override.path.split(".")
    place: dict[str, Any] = document.tree
    for depth, section in enumerate(sections):
        value: Any = resolved.get(section)
        resolved = cast(dict[str, Any], value) if isinstance(value, dict) else {}
        above = sections[: depth + 1]
        dotted = ".".join(above)
        if section not in place:
            place[section] = {} if keys_at(above) else copy.deepcopy(resolved)
        inner: Any = place[section]
        document.origins.setdefault(dotted, override.text)
        if not isinstance(inner, dict):
            raise ConfigError(f"{override.text}: {dotted} is a single value and has no keys")
        place = cast(dict[str, Any], inner)
    place[key] = override.value
    for below in [path for path in document.origins if path.startswith(f"{override.path}.")]:
        del document.origins[below]
    document.origins[override.path] = override.text
