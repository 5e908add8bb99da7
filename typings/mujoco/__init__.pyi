# The library ships no types for its compiled half, so nothing is checked against it.
from typing import Any

def __getattr__(name: str) -> Any: ...
