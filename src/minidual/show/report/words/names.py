"""What a language other than the verdicts' calls the things that verdicts name."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Names:
    """Translations by name.

    Attributes:
        title: Stands for the title that the configuration has by default.
        indicators: Title, meaning and summary by key.
        measures: Title and meaning by name.
        patterns: Reasons and limits as regular expressions, with what stands for them.
        captions: By file name, by its stem, or by the stem up to its first hyphen.
    """

    title: str
    units: Mapping[str, str]
    indicators: Mapping[str, tuple[str, str, str]]
    measures: Mapping[str, tuple[str, str]]
    methods: Mapping[str, str]
    stages: Mapping[str, str]
    conditions: Mapping[str, str]
    failures: Mapping[str, str]
    patterns: Mapping[str, str]
    captions: Mapping[str, str]
