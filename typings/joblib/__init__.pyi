# The library ships no types for its code, so nothing is checked against it.
from typing import Any

def __getattr__(name: str) -> Any: ...
