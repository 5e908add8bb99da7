"""Addresses of policy servers; no connection."""

import hashlib
import json
import os
from pathlib import Path

from minidual import durable

KIND = "server"
"""Type in the config.json that stands for an address."""
_SCHEMES = ("ws://", "wss://")


def is_address(text: str) -> bool:
    """Return whether a text is the address of a policy server."""
    return text.startswith(_SCHEMES)


def folder_of(address: str) -> Path:
    """Return a folder that stands for a server, where a checkpoint's folder is expected.

    Its config.json holds the address: what it is part of depends on the address, and not on the
    weights behind it.
    """
    name = hashlib.sha256(address.encode()).hexdigest()[:16]
    cache = durable.expanded(os.environ.get("MINIDUAL_CACHE") or "~/.cache/minidual")
    folder = cache / "policy-servers" / name
    config = folder / "config.json"
    text = json.dumps({"type": KIND, "address": address}) + "\n"
    if not config.is_file() or config.read_text(encoding="utf-8") != text:
        durable.make_folder(folder)
        durable.write_text(config, text)
    return folder
