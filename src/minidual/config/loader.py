"""Find profiles, load and validate configurations."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast, get_args

import yaml
from pydantic import BaseModel, ValidationError

from minidual.config.document import Document, parse_value, read_document
from minidual.config.root import Config
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
        config = validate_document(document, Config)
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
        return next(
            (path.stem for path in reversed(self.sources) if path.parent == SHIPPED_FOLDER),
            None,
        )

    def reference(self) -> Config:
        """Return the shipped profile that this one is held to."""
        return load_config(self.shipped or DEFAULT_PROFILE).config

    def to_yaml(self) -> str:
        """Return resolved YAML, valid for --profile."""
        head = f"# profile: {self.profile}\n" + "".join(
            f"# {item.text}\n" for item in self.overrides
        )
        return head + yaml.safe_dump(
            self.config.model_dump(mode="json"),
            sort_keys=False,
            allow_unicode=True,
        )


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
        what = f": it is a {kind}" if kind else ""
        shipped = ", ".join(shipped_profiles())
        raise ConfigError(f"no profile file {path}{what}", remedy=f"shipped profiles are {shipped}")
    if path.resolve().parent == SHIPPED_FOLDER:
        return path.stem, path.resolve()
    if path.stem in shipped_profiles():
        taken = f"{path} bears the name of the shipped profile '{path.stem}', its verdicts could not be told apart"
        raise ConfigError(taken, remedy=f"rename it, and begin it with 'extends: {path.stem}'")
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
    loaded = LoadedConfig(validate_document(document, Config), name, sources, (), document)
    return loaded.with_overrides(
        [parse_override(item) if isinstance(item, str) else item for item in overrides],
    )


def _read_chain(path: Path, below: tuple[Path, ...]) -> tuple[Document, tuple[Path, ...]]:
    if path.resolve() in below:
        chain = " -> ".join(item.name for item in (*below, path))
        raise ConfigError(f"{path.name}: profiles extend each other in a circle: {chain}")
    if not (document := read_document(path)).tree:
        raise ConfigError(
            f"{path.name} is empty",
            remedy="begin it with 'extends: standard', then what differs",
        )
    if (base_name := document.tree.pop("extends", None)) is None:
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
        if isinstance(value, dict) and isinstance(base.get(key), dict) and _keys_at(inner):
            _merge(base[key], cast(dict[str, Any], value), inner)
        else:
            base[key] = value


def _refuse_regained_acceptance(
    base: Mapping[str, Any],
    over: Mapping[str, Any],
    where: str,
) -> None:
    if base.get("acceptance") is False and over.get("acceptance", False) is not False:
        cannot = (
            f"{where}: acceptance: a profile that does not count as acceptance cannot be made to"
        )
        raise ConfigError(cannot, remedy="extend 'standard' instead")


def _apply(document: Document, override: Override, resolved: dict[str, Any]) -> None:
    """Set one value; other keys of a mapping stay."""
    if override.path == "acceptance":
        _refuse_regained_acceptance(document.tree, {"acceptance": override.value}, override.text)
    *sections, key = override.path.split(".")
    place: dict[str, Any] = document.tree
    for depth, section in enumerate(sections):
        known: Any = resolved.get(section)
        resolved = cast(dict[str, Any], known) if isinstance(known, dict) else {}
        above = sections[: depth + 1]
        dotted = ".".join(above)
        inner: Any = place.setdefault(section, {} if _keys_at(above) else copy.deepcopy(resolved))
        document.origins.setdefault(dotted, override.text)
        if not isinstance(inner, dict):
            raise ConfigError(f"{override.text}: {dotted} is a single value and has no keys")
        place = cast(dict[str, Any], inner)
    place[key] = override.value
    for below in [path for path in document.origins if path.startswith(f"{override.path}.")]:
        del document.origins[below]
    document.origins[override.path] = override.text


def validate_document[Model: BaseModel](document: Document, model: type[Model]) -> Model:
    """Return the document as a model.

    Raises:
        ConfigError: All problems.
    """
    try:
        return model.model_validate_json(json.dumps(document.tree), strict=True)
    except ValidationError as error:
        problems = [
            _sentence(problem, document, model) for problem in error.errors(include_url=False)
        ]
        hint = next((hint for _, hint in problems if hint), None)
        raise ConfigError("\n".join(text for text, _ in problems), remedy=hint) from None


def _sentence(problem: Any, document: Document, model: type[BaseModel]) -> tuple[str, str | None]:
    kind = problem["type"]
    value = problem.get("input")
    location = _typed_location(
        [str(part) for part in problem["loc"]],
        document.tree,
        missing=kind == "missing",
    )
    dotted = ".".join(location)
    where = _origin(location, document)
    if kind == "extra_forbidden":
        known = sorted(_keys_at(problem["loc"][:-1], model))
        remedy = unknown_name("key", location[-1], known).remedy
        parent = ".".join(location[:-1]) or "the root"
        return f"{where}: {dotted}: no such key; {parent} has {', '.join(known)}", remedy
    if kind == "value_error":
        return f"{where}: {dotted or 'configuration'}: {problem['ctx']['error']}", None
    text = f"{where}: {dotted}: {problem['msg'][:1].lower()}{problem['msg'][1:]}"
    text = (
        text.replace("input should", "must")
        .replace("a valid list", "a list")
        .replace("an object", "a section")
    )
    if isinstance(value, str):
        number = kind.startswith(("int", "float"))
        remedy = (
            "write true or false"
            if "bool" in kind
            else "write a number without quotes"
            if number
            else None
        )
        return f"{text}, is the text '{value}'", remedy
    return text + (
        f", is {json.dumps(value)}" if isinstance(value, bool | int | float | None) else ""
    ), None


def _origin(location: Sequence[str], document: Document) -> str:
    paths = (".".join(location[:length]) for length in range(len(location), 0, -1))
    return next(
        (document.origins[path] for path in paths if path in document.origins),
        document.source,
    )


def _keys_at(location: Sequence[str | int], root: type[BaseModel] = Config) -> set[str]:
    """Return the keys of the models at a typed or pydantic location; empty for a value."""
    models: list[type[BaseModel]] = [root]
    for part in location:
        if fields := [model.model_fields[part] for model in models if part in model.model_fields]:
            models = [found for field in fields for found in _models_in(field.annotation)]
        elif isinstance(part, str):  # a member of a union by its tag, or an entry of a mapping
            models = [
                m for m in models if any(f.default == part for f in m.model_fields.values())
            ] or models
    return {name for model in models for name in model.model_fields}


def _typed_location(location: Sequence[str], tree: Any, *, missing: bool) -> list[str]:
    """Return the location as typed, without pydantic's union members; `missing`: its last key is absent."""
    typed: list[str] = []
    place: Any = tree
    for index, part in enumerate(location):
        if isinstance(place, dict):
            if part not in place and not (missing and index + 1 == len(location)):
                continue
            place = cast(dict[str, Any], place).get(part)
        elif isinstance(place, list) and part.isdigit():
            place = dict(enumerate(cast(list[Any], place))).get(int(part))
        typed.append(part)
    return typed


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in _models_in(argument)]
