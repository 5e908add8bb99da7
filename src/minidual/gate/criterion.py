"""Criteria of a stage: name, comparison, unit and reason of a check, without its numbers."""

from dataclasses import KW_ONLY, dataclass

from minidual.gate.check import Check, Number, Op


@dataclass(frozen=True)
class Criterion:
    """A check without its numbers.

    `why` and `remedy` may contain {names}, which `check` and `report` fill in.

    Attributes:
        name: Name of the check.
        op: Comparison of the observed value with its limit; None if the value is only reported.
        unit: "" for ratios and counts.
        why: What the limit protects, or what the reported value is.
        remedy: What to do if the limit does not hold.
        clocked: Whether a clock measures it: the same work again gives another value.
    """

    name: str
    op: Op | None = None
    _: KW_ONLY
    unit: str = ""
    why: str
    remedy: str = ""
    clocked: bool = False

    def check(
        self,
        observed: Number,
        limit: Number | None,
        *,
        prefix: str = "",
        **details: object,
    ) -> Check:
        """Return the check of an observed value.

        Args:
            observed: Value in `unit`.
            limit: In `unit`; None reports the value without a limit.
            prefix: Prefix of the check's name.
            details: Values of the {names} in `why` and `remedy`.
        """
        return Check(
            f"{prefix}{self.name}",
            observed,
            op=None if limit is None else self.op,
            limit=limit,
            unit=self.unit,
            why=self.why.format(**details),
            remedy=self.remedy.format(**details),
            clocked=self.clocked,
        )

    def report(self, observed: Number, *, prefix: str = "", **details: object) -> Check:
        """Return the value as a check without a limit."""
        return self.check(observed, None, prefix=prefix, **details)
