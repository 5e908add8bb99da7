"""The network between leader and arms that a recording simulates, as a person types it."""

import re
from dataclasses import dataclass, fields
from typing import Self

_NUMBER = r"(\d+(?:\.\d+)?)"
_FORMS = {
    "delay": re.compile(rf"{_NUMBER}(ms|s)"),
    "jitter": re.compile(rf"{_NUMBER}(ms|s)"),
    "loss": re.compile(rf"{_NUMBER}(%)"),
    "reorder": re.compile(rf"{_NUMBER}(%)"),
}
_SHARES = {"ms": 1e-3, "s": 1.0, "%": 1e-2}
_BOUNDS = {
    "delay": (2.0, "2s"),
    "jitter": (1.0, "1s"),
    "loss": (0.5, "50%"),
    "reorder": (0.5, "50%"),
}
EXAMPLE = "delay=100ms,jitter=20ms,loss=5%,reorder=1%"


@dataclass(frozen=True)
class SimulatedNetwork:
    """A network in both directions.

    Attributes:
        delay: Of a round trip [s]; each way takes half of it.
        jitter: Largest change of the round trip's delay [s], up and down.
        loss: Share of packets lost, each way.
        reorder: Share of packets that are held back, so that later ones overtake them.
    """

    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0
    reorder: float = 0.0

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the network that a text describes, such as `delay=100ms,jitter=20ms,loss=5%`.

        Raises:
            ValueError: Unknown or repeated name, no such unit, or out of bounds.
        """
        values: dict[str, float] = {}
        for part in text.split(","):
            name, _, value = part.strip().partition("=")
            if name not in _FORMS:
                parts = ", ".join(_FORMS)
                raise ValueError(
                    f"no part '{name}' of a network; there are {parts}, as in {EXAMPLE}"
                )
            if name in values:
                raise ValueError(f"'{name}' is given twice")
            values[name] = _number(name, value)
        return cls(**values)

    @property
    def text(self) -> str:
        """What `parse` takes."""
        parts: list[str] = []
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in ("delay", "jitter"):
                parts.append(f"{field.name}={1e3 * value:g}ms")
            else:
                parts.append(f"{field.name}={1e2 * value:g}%")
        return ",".join(parts)


def _number(name: str, text: str) -> float:
    match = _FORMS[name].fullmatch(text)
    largest, largest_text = _BOUNDS[name]
    if match is None:
        unit = "ms or s" if name in ("delay", "jitter") else "%"
        raise ValueError(f"{name}={text}: expected a number with {unit}, as in {EXAMPLE}")
    value = float(match[1]) * _SHARES[match[2]]
    if value > largest:
        raise ValueError(f"{name}={text}: at most {largest_text}")
    return value
