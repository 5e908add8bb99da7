"""One observed value and its limit."""

import math
import operator
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

from minidual.gate.canonical import canonical

Op = Literal["<", "<=", ">", ">=", "=="]
Number = float | int | bool

_COMPARE = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
}
_BITS_MAX = 1000
"""Of integers: a float holds up to 1024."""


def _plain_number(value: Any, name: str) -> Number:
    if not isinstance(value, bool | int | float) and _is_numpy_scalar(value):
        value = value.item()
    if not isinstance(value, bool | int | float):
        raise TypeError(
            f"{name} must be a number or a bool, not {type(value).__name__} ({value!r})"
        )
    if isinstance(value, int) and value.bit_length() > _BITS_MAX:
        raise ValueError(f"{name} has {value.bit_length()} bits, more than a float holds")
    return value


def _is_numpy_scalar(value: Any) -> bool:
    return hasattr(value, "item") and getattr(value, "ndim", 0) == 0


@dataclass(frozen=True)
class Check:
    """A named observation with its limit.

    Without `op` it is only reported. A non-finite `observed` fails every limit.

    Attributes:
        unit: "" for ratios and counts.
        why: What the limit protects.
        remedy: What to do when it fails.
        clocked: Whether a clock measured it: the same work again gives another value.
    """

    name: str
    observed: Number
    op: Op | None = None
    limit: Number | None = None
    unit: str = ""
    why: str = ""
    remedy: str = ""
    clocked: bool = False

    def __post_init__(self) -> None:
        if not self.name or any(c.isspace() for c in self.name):
            raise ValueError(f"a check needs a name without blanks, not {self.name!r}")
        observed = _plain_number(self.observed, f"check {self.name}: observed")
        object.__setattr__(self, "observed", observed)
        if self.op is None:
            if self.limit is not None:
                raise ValueError(f"check {self.name}: limit {self.limit} without an operator")
            return
        if self.op not in _COMPARE:
            names = ", ".join(get_args(Op))
            raise ValueError(f"check {self.name}: no operator {self.op!r}; there are {names}")
        limit = _plain_number(self.limit, f"check {self.name}: limit")
        if not math.isfinite(limit):
            raise ValueError(f"check {self.name}: the limit must be finite, is {limit}")
        object.__setattr__(self, "limit", limit)

    @property
    def passed(self) -> bool | None:
        """Whether the limit holds; None without one."""
        if self.op is None or self.limit is None:
            return None
        return math.isfinite(self.observed) and _COMPARE[self.op](self.observed, self.limit)

    @property
    def margin(self) -> float | None:
        """Distance to the limit [`unit`], positive if it holds.

        Minus the deviation for "=="; None without a limit or for bools.
        """
        if self.op is None or self.limit is None or isinstance(self.limit, bool):
            return None
        excess = float(self.observed) - float(self.limit)
        if self.op in (">", ">="):
            return excess
        # Subtracted from 0.0, so that no margin is -0.0.
        if self.op in ("<", "<="):
            return 0.0 - excess
        return 0.0 - abs(excess)

    @property
    def relative_margin(self) -> float | None:
        """Margin relative to the limit; None where that has no meaning."""
        margin = self.margin
        if margin is None or not math.isfinite(margin):
            return None
        if not self.limit or self.op == "==":
            return None
        return margin / abs(self.limit)

    def margin_text(self) -> str:
        """Return, for example, "+0.05 (+25%)"; "" without a margin."""
        margin = self.margin
        if margin is None or not math.isfinite(margin) or self.op == "==":
            return ""
        text = f"{margin:+.3g}"
        relative = self.relative_margin
        return text if relative is None else f"{text} ({relative:+.0%})"

    def sentence(self) -> str:
        """Return, for example, "tilt_max_rad is 0.12 rad, limit <= 0.0873 rad"."""
        text = f"{self.name} is {with_unit(self.observed, self.unit)}"
        if self.op is None:
            return text
        return f"{text}, limit {self.op} {with_unit(self.limit, self.unit)}"

    def to_json(self) -> dict[str, Any]:
        """Return JSON types, with result and margin; `clocked` only if it is."""
        record = {**asdict(self), "passed": self.passed, "margin": self.margin}
        if not self.clocked:
            del record["clocked"]
        return canonical(record)

    def content(self) -> dict[str, Any]:
        """Return the reproducible part: no text, and no value of a clock."""
        return {
            "name": self.name,
            "observed": None if self.clocked else self.observed,
            "op": self.op,
            "limit": self.limit,
            "unit": self.unit,
            "passed": self.passed,
        }


def with_unit(value: Number | None, unit: str) -> str:
    """Return four significant digits and the unit; yes or no for bools."""
    if isinstance(value, bool):
        text = "yes" if value else "no"
    elif isinstance(value, float):
        text = f"{value:.4g}"
    else:
        text = str(value)
    return f"{text} {unit}".rstrip()


Rows = Mapping[str, Number | tuple[Number, Op, Number | None]]
"""{check: observed value, or (observed value, operator, limit)}.

Without a limit the value is only reported.
"""


def checks_of(
    words: Mapping[str, Mapping[str, str]],
    rows: Rows,
    prefix: str = "",
    **names: object,
) -> list[Check]:
    """Return a check for each row.

    Args:
        words: {check: {"unit", "why", "remedy": text}}.
        rows: Observed values and limits.
        prefix: Of the names.
        **names: Filled into the texts, as by `str.format`.
    """
    checks: list[Check] = []
    for name, row in rows.items():
        observed, op, limit = row if isinstance(row, tuple) else (row, None, None)
        if limit is None:
            op = None
        texts = {key: text.format(**names) for key, text in words[name].items()}
        check = Check(
            f"{prefix}{name}",
            observed,
            op,
            limit,
            unit=texts.get("unit", ""),
            why=texts.get("why", ""),
            remedy=texts.get("remedy", ""),
        )
        checks.append(check)
    return checks
