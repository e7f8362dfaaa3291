"""Hooks of mkdocs: pages link to files of the repository outside docs/, and the site gets a copy of these.

A link that leaves docs/ works in the repository and in the site: ``../results/search/table.md``.
"""

import re
from pathlib import Path

from mkdocs.structure.files import File

ROOT = Path(__file__).parents[1]
OUTSIDE = ("ARCHITECTURE.md", "results/**/*.md", "results/**/*.png", "results/**/*.csv")

_LINK = re.compile(r"(\]\()((?:\.\./)*)([^)\s#]+)")


def on_files(files, config):
    """Add the files outside docs/."""
    for pattern in OUTSIDE:
        for path in sorted(ROOT.glob(pattern)):
            name = path.relative_to(ROOT).as_posix()
            files.append(File.generated(config, name, abs_src_path=str(path)))
    return files


def on_page_markdown(markdown, page, config, files):
    """Turn links between docs/ and the rest of the repository into links inside the site."""
    depth = page.file.src_uri.count("/")
    outside = page.file.generated_by is not None

    def inside(match: re.Match) -> str:
        begin, up, rest = match.groups()
        levels = len(up) // 3
        if outside and levels == depth and rest.startswith("docs/"):
            return begin + up + rest.removeprefix("docs/")
        if not outside and levels == depth + 1:
            return begin + up.removeprefix("../") + rest
        return match[0]

    return _LINK.sub(inside, markdown)
