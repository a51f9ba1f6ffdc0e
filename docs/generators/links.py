"""Every link, picture and anchor of a built site is there, and nothing comes from elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADED = {"img": "src", "script": "src", "link": "href", "iframe": "src", "source": "src"}


class Page(HTMLParser):
    """What a page refers to, and the anchors that it has."""

    def __init__(self, text: str) -> None:
        """Parse a page."""
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[tuple[str, str]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note ids, links and what is loaded."""
        given = {k: v or "" for k, v in attrs}
        self.anchors |= {given[k] for k in ("id", "name") if given.get(k)}
        key = LOADED.get(tag, "href" if tag == "a" else "")
        if given.get(key) and given.get("rel") not in ("canonical", "next", "prev"):
            self.links.append((tag, given[key]))


def faults(site: Path) -> Iterator[str]:
    """Yield a sentence for each link of a site that leads nowhere, or is loaded from elsewhere."""
    pages = {path: Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    for path, page in pages.items():
        if path.name == "404.html":    # its links count from the site's root
            continue
        for tag, link in page.links:
            parts = urlsplit(link)
            where = f"{path.relative_to(site)}: <{tag}> {link}"
            if parts.scheme or parts.netloc:
                if tag != "a" and parts.scheme != "data":
                    yield f"{where} is loaded from elsewhere"
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            if not target.exists():
                yield f"{where} is not there"
            elif parts.fragment and target in pages and (
                    unquote(parts.fragment) not in pages[target].anchors):
                yield f"{where} has no such anchor"


if __name__ == "__main__":
    found = list(faults(Path(sys.argv[1]).resolve()))
    print(*found, f"{len(found)} faults in the links of the site.", sep="\n")
    sys.exit(bool(found))
