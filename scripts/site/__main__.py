"""Build the documentation site. Errors and warnings of any page end it with exit code 1."""

import argparse
import shutil
import sys
from pathlib import Path

from scripts.site.build import ROOT, build_site


def main() -> int:
    """Build, and print where the site is."""
    parser = argparse.ArgumentParser(prog="python -m scripts.site", description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "site", help="folder")
    out: Path = parser.parse_args().out.resolve()
    pages = out.with_name("pages")
    shutil.rmtree(pages, ignore_errors=True)
    problems = build_site(pages, out)
    for problem in problems:
        print(problem, file=sys.stderr)
    if problems:
        print(f"{len(problems)} problems; see above", file=sys.stderr)
        return 1
    print(f"site: {out / 'index.html'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
