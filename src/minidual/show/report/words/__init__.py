"""Words of the report in each language."""

import re
from collections.abc import Mapping
from pathlib import PurePath
from typing import Any, Literal

from markupsafe import Markup

from minidual.config.root import ReportConfig
from minidual.gate.check import Check, with_unit
from minidual.show.report.indicators import Indicator
from minidual.show.report.words import en, zh, zh_names
from minidual.show.report.words.names import Names
from minidual.tasks.failures import FAILURES, FailureName
from minidual.trials.measures import Measure

type Language = Literal["en", "zh"]

TEXTS: Mapping[str, Mapping[str, str]] = {"en": en.TEXT, "zh": zh.TEXT}
"""{language: {key: text with fields}}."""
_TAGS = {"en": "en", "zh": "zh-CN"}
_DEFAULT_TITLE = ReportConfig().title


class Words:
    """Words of one language. Verdicts are in English, the source; other languages translate names.

    Text of a verdict that has no translation is marked as English.
    """

    def __init__(self, language: Language) -> None:
        self.language = language
        self._text = TEXTS[language]
        self._names: Names | None = zh_names.NAMES if language == "zh" else None

    def __call__(self, key: str, **values: Any) -> str:
        """Return the text of a key, its fields filled in; HTML if a field is HTML."""
        text = self._text[key]
        if any(isinstance(value, Markup) for value in values.values()):
            return Markup(text).format(**values)
        return text.format(**values)

    @property
    def tag(self) -> str:
        """The language's tag in HTML."""
        return _TAGS[self.language]

    @property
    def is_source(self) -> bool:
        """Whether verdicts are in this language."""
        return self._names is None

    def foreign(self, text: str) -> str:
        """Return a verdict's text, marked if the page has another language."""
        if self._names is None or not text:
            return text
        return Markup('<span lang="en">{}</span>').format(text)

    def _named(self, table: Mapping[str, str], name: str, source: str) -> str:
        """Return the translation of a name; without one the source's words."""
        return table.get(name) or self.foreign(source)

    def title(self, title: str) -> str:
        """Return the page's title; the default one is translated."""
        if self._names is not None and title == _DEFAULT_TITLE:
            return self._names.title
        return title

    def unit(self, unit: str) -> str:
        """Return a displayed unit."""
        return unit if self._names is None else self._names.units.get(unit, unit)

    def indicator(self, indicator: Indicator) -> str:
        """Return its heading."""
        return self._of_indicator(indicator, indicator.title, 0)

    def meaning(self, indicator: Indicator) -> str:
        """Return the description of one trial's value."""
        return self._of_indicator(indicator, indicator.meaning, 1)

    def over(self, indicator: Indicator) -> str:
        """Return how the trials become the compared number."""
        return self._of_indicator(indicator, indicator.over, 2)

    def _of_indicator(self, indicator: Indicator, source: str, place: int) -> str:
        if self._names is None:
            return source
        return self._names.indicators[indicator.key][place]

    def measure(self, name: str, measure: Measure) -> str:
        """Return the title of a further measure."""
        return measure.title if self._names is None else self._names.measures[name][0]

    def measure_meaning(self, name: str, measure: Measure) -> str:
        """Return the description of a further measure."""
        return measure.meaning if self._names is None else self._names.measures[name][1]

    def method(self, name: str, summary: str) -> str:
        """Return the description of a method."""
        return self._named(self._names.methods, name, summary) if self._names else summary

    def stage(self, name: str, summary: str) -> str:
        """Return the description of a stage."""
        return self._named(self._names.stages, name, summary) if self._names else summary

    def condition(self, name: str, summary: str) -> str:
        """Return the description of a condition."""
        return self._named(self._names.conditions, name, summary) if self._names else summary

    def failure(self, counted: str) -> str:
        """Return a failure as the summaries count it, "condition (phase)"."""
        name, phase = FailureName.parse(counted)
        source = FAILURES.get(name) or name.replace("_", " ") or "unnamed"
        failure = self._named(self._names.failures, name, source) if self._names else source
        return self("failure.phase", failure=failure, phase=phase) if phase else failure

    def reason(self, text: str) -> str:
        """Return why a cell is empty, or its promised limit."""
        if self._names is None:
            return text
        for pattern, translation in self._names.patterns.items():
            match = re.fullmatch(pattern, text)
            if match:
                return match.expand(translation)
        return self.foreign(text)

    def caption(self, name: str, source: str) -> str:
        """Return the caption of a file."""
        if self._names is None:
            return source
        stem = PurePath(name).stem
        for key in (name, stem, stem.partition("-")[0]):
            if key in self._names.captions:
                return self._names.captions[key]
        return self.foreign(source)

    def check(self, check: Check) -> str:
        """Return a check with its limit as a clause."""
        return self(
            "check.sentence",
            name=check.name,
            observed=with_unit(check.observed, check.unit),
            op=check.op,
            bound=with_unit(check.limit, check.unit),
        )
