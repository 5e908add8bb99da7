"""The pages of README and docs, and the commands that they print."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted({ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("*/README.md")})


def printed_commands() -> list[tuple[str, str]]:
    """Return (page, command) of each line of a code block that types minidual.

    Synopses with [...] are left out.
    """
    commands: list[tuple[str, str]] = []
    for page in PAGES:
        text = re.sub(r" *\\\n *", " ", page.read_text(encoding="utf-8"))
        blocks = re.findall(r"^```(\w*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
        fenced = "\n".join(body for language, body in blocks if language in ("", "bash", "sh"))
        indented = "\n".join(re.findall(r"^ {4}(\S.*)$", text, re.MULTILINE))
        for line in re.findall(
            r"^(?:\.venv/bin/)?(minidual [^\n]*)$",
            f"{fenced}\n{indented}",
            re.MULTILINE,
        ):
            command = re.sub(r"\s+#.*$|\s{3,}\S.*$", "", line).strip()
            if "[" not in command:
                commands.append((page.relative_to(ROOT).as_posix(), command))
    return list(dict.fromkeys(commands))
