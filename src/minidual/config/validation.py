"""Check a document against a model, and say where and why it fails."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, NamedTuple, cast, get_args

from pydantic import BaseModel, ValidationError

from minidual.config.document import Document
from minidual.config.root import Config
from minidual.errors import ConfigError, unknown_name


class _Problem(NamedTuple):
    text: str
    remedy: str | None = None


def validate_document[Model: BaseModel](document: Document, model: type[Model]) -> Model:
    """Return the document as a model.

    Raises:
        ConfigError: All problems.
    """
    return validate_section(document, (), model)


def validate_section[Model: BaseModel](
    document: Document,
    section: Sequence[str],
    model: type[Model],
) -> Model:
    """Return a section of a document as a model.

    Args:
        document: The whole.
        section: Keys that lead to the section.
        model: Of the section.

    Raises:
        ConfigError: All problems.
    """
    tree: Any = document.tree
    for key in section:
        tree = tree[key]
    try:
        return model.model_validate_json(json.dumps(tree), strict=True)
    except ValidationError as error:
        details = error.errors(include_url=False)
        problems = [_problem(detail, document, section, model) for detail in details]
        remedies = [problem.remedy for problem in problems if problem.remedy]
        raise ConfigError(
            "\n".join(problem.text for problem in problems),
            remedy=remedies[0] if remedies else None,
        ) from None


def _problem(
    detail: Any,
    document: Document,
    section: Sequence[str],
    model: type[BaseModel],
) -> _Problem:
    """Return one error of pydantic in the words of the document."""
    kind = detail["type"]
    location = _typed_location(
        [*section, *(str(part) for part in detail["loc"])],
        document.tree,
        missing=kind == "missing",
    )
    dotted = ".".join(location)
    where = _origin(location, document)
    if kind == "extra_forbidden":
        keys = sorted(keys_at(detail["loc"][:-1], model))
        remedy = unknown_name("key", location[-1], keys).remedy
        parent = ".".join(location[:-1]) or "the root"
        return _Problem(f"{where}: {dotted}: no such key; {parent} has {', '.join(keys)}", remedy)
    if kind == "value_error":
        return _Problem(f"{where}: {dotted or 'configuration'}: {detail['ctx']['error']}")
    text = f"{where}: {dotted}: {_plain(detail['msg'])}"
    value = detail.get("input")
    if isinstance(value, str):
        return _Problem(f"{text}, is the text '{value}'", _remedy_of_text(kind))
    if isinstance(value, bool | int | float | None):
        return _Problem(f"{text}, is {json.dumps(value)}")
    return _Problem(text)


def _plain(message: str) -> str:
    """Return a message of pydantic without its jargon."""
    text = message[:1].lower() + message[1:]
    text = text.replace("input should", "must")
    text = text.replace("a valid list", "a list")
    return text.replace("an object", "a section")


def _remedy_of_text(kind: str) -> str | None:
    if "bool" in kind:
        return "write true or false"
    if kind.startswith(("int", "float")):
        return "write a number without quotes"
    return None


def _origin(location: Sequence[str], document: Document) -> str:
    """Return "file.yaml:12" of a location or of the nearest one above it."""
    for length in range(len(location), 0, -1):
        path = ".".join(location[:length])
        if path in document.origins:
            return document.origins[path]
    return document.source


def keys_at(location: Sequence[str | int], root: type[BaseModel] = Config) -> set[str]:
    """Return the keys of the models at a typed or pydantic location; empty for a value."""
    models: list[type[BaseModel]] = [root]
    for part in location:
        fields = [model.model_fields[part] for model in models if part in model.model_fields]
        if fields:
            models = [model for field in fields for model in _models_in(field.annotation)]
        elif isinstance(part, str):  # a member of a union by its tag, or an entry of a mapping
            models = [model for model in models if _has_tag(model, part)] or models
    return {name for model in models for name in model.model_fields}


def _has_tag(model: type[BaseModel], tag: str) -> bool:
    return any(field.default == tag for field in model.model_fields.values())


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in _models_in(argument)]


def _typed_location(location: Sequence[str], tree: Any, *, missing: bool) -> list[str]:
    """Return the location as typed, without pydantic's union members.

    Args:
        location: Of pydantic.
        tree: What was typed.
        missing: Whether its last key is absent.
    """
    typed: list[str] = []
    place: Any = tree
    for index, part in enumerate(location):
        if isinstance(place, dict):
            mapping = cast(dict[str, Any], place)
            is_missing_key = missing and index + 1 == len(location)
            if part not in mapping and not is_missing_key:
                continue
            place = mapping.get(part)
        elif isinstance(place, list) and part.isdigit():
            items = cast(list[Any], place)
            place = items[int(part)] if int(part) < len(items) else None
        typed.append(part)
    return typed
