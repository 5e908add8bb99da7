"""Sentences on two methods, each with its number, interval and test."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup, escape

from minidual.show.report.words import Words
from minidual.trials.answers import DIFFERENCE, HEADLINES_MAX, Answer, headlines
from minidual.trials.conditions import CLEAN
from minidual.trials.contrasts import Contrast

_PAIRS_MAX = 4
"""Most pairs of methods in the sentence on what cannot be told apart."""
_BRACKETS = re.compile(r"\([^()]*\)|（[^（）]*）")


def headline_sentences(tasks: Mapping[str, Mapping[str, Any]], words: Words) -> list[str]:
    """Return at most five sentences on the differences that the benchmark shows; the last is on open ones.

    Args:
        tasks: {task: its part of the benchmark's data}.
        words: Of the page's language.
    """
    answers = headlines(tasks)
    telling = [answer for answer in answers if answer.tells]
    silent = [answer for answer in answers if not answer.tells]
    room = HEADLINES_MAX - 1 if silent else HEADLINES_MAX
    sentences = [sentence(answer, words) for answer in telling[:room]]
    if silent:
        sentences.append(_cannot_tell(silent, words))
    return sentences


def sentence(answer: Answer, words: Words) -> str:
    """Return the difference that an answer shows, or how many trials would show one."""
    if not answer.tells:
        return _cannot_tell([answer], words)
    if answer.success_differs:
        text = _more_often(answer, words)
        if answer.motions:
            text += words("answer.where_both", motions=_motions(answer, words))
    else:
        text = _motions(answer, words) + _no_difference(answer, words)
    return _on(answer, text, words) + words("answer.end")


def _on(answer: Answer, rest: str, words: Words) -> str:
    if answer.condition == CLEAN:
        return words("on", task=answer.task, rest=rest)
    return words("on_under", task=answer.task, condition=answer.condition, rest=rest)


def _more_often(answer: Answer, words: Words) -> str:
    wins = answer.successes
    better, worse = sorted(wins, key=lambda name: -wins[name])
    low, high = sorted((abs(answer.low), abs(answer.high)))
    return words(
        "answer.more_often",
        better=better,
        worse=worse,
        better_n=wins[better],
        worse_n=wins[worse],
        trials_n=answer.trials_n,
        points=f"{100.0 * abs(answer.rate_difference):.0f}",
        low=f"{100.0 * low:.0f}",
        high=f"{100.0 * high:.0f}",
        p=p_text(answer.p_value, words),
    )


def _no_difference(answer: Answer, words: Words) -> str:
    return words(
        "answer.no_difference",
        trials_n=answer.trials_n,
        first_n=answer.successes[answer.first],
        second_n=answer.successes[answer.second],
        p=p_text(answer.p_value, words),
        needed=_needed([answer], words),
    )


def _needed(answers: Sequence[Answer], words: Words) -> str:
    """Return how many trials would tell."""
    at_these_rates = answers[0].needed_at_these_rates if len(answers) == 1 else None
    if at_these_rates is not None:
        return words("answer.needed_rates", n=at_these_rates)
    most_n = max(answer.needed_for_difference for answer in answers)
    return words("answer.needed", n=most_n, points=f"{100.0 * DIFFERENCE:.0f}")


def _cannot_tell(answers: Sequence[Answer], words: Words) -> str:
    if len(answers) == 1:
        return _of_pair("answer.cannot", answers[0], words, needed=_needed(answers, words))
    pairs = [_of_pair("answer.cannot_pair", one, words) for one in answers[:_PAIRS_MAX]]
    if len(answers) > _PAIRS_MAX:
        pairs.append(words("answer.cannot_more", n=len(answers) - _PAIRS_MAX))
    text = words("comma").join(pairs)
    return words("answer.cannot_several", pairs=text, needed=_needed(answers, words))


def _of_pair(key: str, answer: Answer, words: Words, **further: str) -> str:
    return words(
        key,
        **further,
        task=answer.task,
        first=answer.first,
        second=answer.second,
        first_n=answer.successes[answer.first],
        second_n=answer.successes[answer.second],
        trials_n=answer.trials_n,
    )


def _motions(answer: Answer, words: Words) -> str:
    """Return the differences of the motions, by the method that each favours."""
    by_method: dict[str, list[str]] = {}
    for contrast in answer.motions:
        by_method.setdefault(contrast.better, []).append(_phrase(contrast, words))
    parts = [
        words("motion.of", method=method, phrases=_listed(phrases, words))
        for method, phrases in by_method.items()
    ]
    largest_p = max(contrast.p_value for contrast in answer.motions)
    return words(
        "answer.tests",
        motions=words("comma").join(parts),
        p=p_text(largest_p, words, each=len(answer.motions) > 1),
    )


def _listed(phrases: Sequence[str], words: Words) -> str:
    """Return "a, b and c"."""
    *others, last = phrases
    return words("and").join([words("list").join(others), last]) if others else last


def _phrase(contrast: Contrast, words: Words) -> str:
    """Return a difference with its interval, in the unit that people use."""
    scale = 1.0
    if contrast.quantity == "torque_ratio_max":
        scale = 100.0
    elif contrast.quantity == "jerk_rms":
        scale = 100.0 / max(contrast.first_median, contrast.second_median)
    digits = 2 if contrast.quantity == "duration_s" else 0
    low, high = sorted((abs(contrast.low), abs(contrast.high)))
    return words(
        f"motion.{contrast.quantity}",
        size=f"{scale * abs(contrast.difference):.{digits}f}",
        low=f"{scale * low:.{digits}f}",
        high=f"{scale * high:.{digits}f}",
    )


def p_text(p_value: float, words: Words, *, each: bool = False) -> str:
    """Return "p = 0.012", tiny ones as "p < 0.001"; `each`: it is the largest of several."""
    if p_value < 0.001:
        return words("p.each_tiny" if each else "p.tiny")
    return words("p.each" if each else "p.equal", p=f"{p_value:.2g}")


def evidence(text: str) -> Markup:
    """Return a sentence as HTML, its brackets set back: they hold intervals and tests."""

    def set_back(match: re.Match[str]) -> str:
        return f'<span class="evidence">{match[0]}</span>'

    return Markup(_BRACKETS.sub(set_back, str(escape(text))))
