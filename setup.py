"""The page of the package on an index: the README, whose relative links lead nowhere there.

All else is in pyproject.toml. Where [project.urls] names the repository, links and pictures lead into it;
else links are words.
"""

import re
import tomllib
from pathlib import Path

from setuptools import setup

ROOT = Path(__file__).parent


def description(text: str, repository: str | None) -> str:
    """Return a README whose links work anywhere."""

    def link(match):
        picture, words, target = match.groups()
        if re.match(r"https?:|#", target):
            return match[0]
        if repository:
            return f"{picture}[{words}]({repository}/{'raw' if picture else 'blob'}/main/{target})"
        return "" if picture else words

    return re.sub(r"(!?)\[([^\]\n]*)\]\(([^)\s]+)\)", link, text)


if __name__ == "__main__":
    urls = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"].get("urls", {})
    readme = description((ROOT / "README.md").read_text(encoding="utf-8"), urls.get("Repository"))
    setup(long_description=readme, long_description_content_type="text/markdown")
