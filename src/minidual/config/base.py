"""Base of the configuration models, and marks of fields that acceptance depends on."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field

Value = TypeVar("Value")
AtLeast = Annotated[Value, "at least"]
"""A count or lower limit; below the shipped profile's is no acceptance."""
AtMost = Annotated[Value, "at most"]
"""An upper limit; above the shipped profile's is no acceptance."""
Rate = Annotated[float, Field(ge=0.0, le=1.0)]
Coordinate = Annotated[float, Field(ge=-10.0, le=10.0)]
"""Of a place near the robot [m], or of a rotation [rad]."""
Size = Annotated[float, Field(ge=1e-3, le=10.0)]
"""Of a thing [m]."""


class StrictModel(BaseModel):
    """Frozen; refuses unknown keys, NaN and infinity. `validate_document` adds strict types."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        strict=False,
        validate_default=True,
    )

    def demands(self) -> dict[str, Any]:
        """Return {name: value} of what several fields together ask for.

        Less than in the shipped profile is no acceptance.
        """
        return {}


def limits(
    model: StrictModel,
    prefix: str = "",
) -> Iterator[tuple[str, Literal["at least", "at most"], Any]]:
    """Yield (dotted path, mark, value) of each marked field and of what `demands` returns."""
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        for mark in ("at least", "at most"):
            if mark in field.metadata:
                yield f"{prefix}{name}", mark, value
        if isinstance(value, StrictModel):
            yield from limits(value, f"{prefix}{name}.")
    for name, value in model.demands().items():
        yield f"{prefix}{name}", "at least", value
